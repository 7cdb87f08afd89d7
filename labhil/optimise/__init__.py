"""Optimisation of the geometry of the solenoid (Appendix A of the reference text); start at ``study``."""
