"""Results and recordings as pages: one self-contained HTML file each.

``report.py`` makes the page of a file, ``study.py`` that of a fresh result; ``page.py`` is their frame.
"""
