"""The arm behind the controller: a plan goes in, what its sensors say comes out."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from labhil.signals import FloatArray
from labhil_sim_ur5.motion import Plan


class Reading(NamedTuple):
    """What the controller measures and expects at one moment, (6,) each but for the voltage.

    rad, rad/s, A, A, N·m, °C, V.
    """

    q: FloatArray
    qd: FloatArray
    current: FloatArray
    target_current: FloatArray
    target_moment: FloatArray
    temperature: FloatArray
    voltage: float


class Arm(Protocol):
    """What the controller drives."""

    def place(self, q: FloatArray) -> None:
        """Put the arm at rest at angles (6,) rad."""
        ...

    def step(self, plan: Plan, h: float) -> Reading:
        """Let h (s) pass while the drives are told to follow the plan, and measure then."""
        ...


class IdealArm:
    """Joints that are where they are told to be, without weight: only for tests of the protocol."""

    def __init__(self) -> None:
        self._warm = np.full(6, 27.0)
        self._nothing = np.zeros(6)

    def place(self, q: FloatArray) -> None:
        """Nothing to do: the plan says where it is."""

    def step(self, plan: Plan, h: float) -> Reading:
        """Be there."""
        nothing = self._nothing
        return Reading(plan.q, plan.qd, nothing, nothing, nothing, self._warm, 48.0)
