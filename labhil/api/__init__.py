"""The functions and results of ``import labhil``: the one way in, for people as for the commands.

Each module holds a function with the class that it returns. All are imported by ``labhil/__init__.py`` when
they are first used.
"""
