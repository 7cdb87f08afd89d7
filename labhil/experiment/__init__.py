"""Scripted acquisitions: the experiment file, excitations, and the runner."""
