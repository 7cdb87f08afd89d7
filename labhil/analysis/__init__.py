"""From files to results: load recordings, check them, fit, diagnose, verify, and write and read the JSON.

Tables, plots and pages of these results are in ``labhil.report``; the functions that people call, from Python
and from the command line, are in ``labhil.api``.
"""
