"""Inverse dynamics of a robot arm: rigid-body model, joint laws, preparation of recordings."""

from labhil.physics.arm.model import ArmModel

__all__ = ["ArmModel"]
