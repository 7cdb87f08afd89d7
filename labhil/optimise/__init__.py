"""Optimisation of designs: the geometry of the solenoid (Appendix A of the reference text)."""
