"""The commands of ``labhil``: their options, and the calls that do the work.

``labhil/command_line.py`` registers them.
"""
