"""Files that are damaged, made at random, or made to do harm, and what the commands make of them.

:mod:`.kinds` lists which files are spoilt how and which command reads them; :mod:`.harm` holds files that
were written to harm; :mod:`.reader` runs a command in a process of its own; :mod:`.verdict` decides what is a
fault.
"""
