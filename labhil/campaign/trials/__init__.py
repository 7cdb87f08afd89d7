"""Sealed trials: rigs with concealed physics, diagnosed blind, scored against answers sealed beforehand."""
