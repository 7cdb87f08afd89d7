"""The terminal UI: devices, live plots, experiments, recordings and results.

Begin with ``app.py`` (tabs, keys, emergency stop) and ``bus_watch.py`` (what devices send).
"""
