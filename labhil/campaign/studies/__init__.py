"""Fits and diagnoses as processes of their own: for the screen, and for the service of a lab."""
