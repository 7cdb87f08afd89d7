"""The terminal UI: what a person in the lab works with."""
