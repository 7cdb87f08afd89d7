"""labhil: record a rig and its simulation, find where they disagree, and name the missing physics."""

__version__ = "0.1.0"
