"""Results and recordings for people: tables in a terminal, plots, and HTML pages.

Begin with ``text.py`` (tables), ``plots.py`` (figures) or ``html/report.py`` (pages).
"""
