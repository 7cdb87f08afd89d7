"""The commands of ``labhil``: their options, and the calls that do the work.

``labhil/cli.py`` registers them.
"""
