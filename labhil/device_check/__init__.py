"""A short check of a connected device: units, limits and rates at rest, then the sign of a small step.

It needs both wings: a bench at hand (:mod:`labhil.experiment.bench`), and the model that says which way the
rig answers (:mod:`labhil.physics`). ``check.py`` is the whole procedure.
"""
