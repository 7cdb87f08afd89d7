"""The arm as it is fitted, by inverse dynamics: rigid body, joints, preparation of recordings."""

from labhil.physics.arm.model import ArmModel

__all__ = ["ArmModel"]
