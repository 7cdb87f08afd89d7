"""Drivers of rigs on the framed serial link: all that is the same whatever the rig."""
