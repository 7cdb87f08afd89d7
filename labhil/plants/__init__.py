"""Simulated worlds. They share no code with the models that are fitted (``physics``), on purpose."""
