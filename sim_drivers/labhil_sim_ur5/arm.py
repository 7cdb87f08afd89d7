"""The arm behind the controller: a plan goes in, what its sensors say comes out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labhil.plants.arm.links import UR5
from labhil.plants.arm.live import LiveArm, Sample, Setpoint
from labhil.plants.arm.newton_euler import RecursiveBody
from labhil.signals import FloatArray
from labhil_sim_ur5.motion import Plan
from labhil_sim_ur5.poses import Point

GRAVITY: Point = (0.0, 0.0, -9.81)


class PhysicalArm:
    """The simulated UR5: rigid links, friction, warmth, sensors; ``terms`` and ``parameters`` make it up."""

    def __init__(self, parameters: Mapping[str, float], terms: tuple[str, ...], seed: int) -> None:
        self.links = UR5
        self._live = LiveArm(parameters, terms, seed, UR5)

    @property
    def parameters(self) -> dict[str, float]:
        """Every number of the plant by its key."""
        return self._live.parameters

    @property
    def torque_constant(self) -> FloatArray:
        """N·m/A at the joints (6,)."""
        return self._live.torque_constant

    @property
    def model(self) -> RecursiveBody:
        """What the controller believes the arm and its payload to be."""
        return self._live.expected()

    def expect(self, mass: float, centre: Point, gravity: Point) -> None:
        """Tell the controller's model what the flange carries (kg, m) and which way weight pulls (m/s²)."""
        self._live.set_expected_load(mass, centre, gravity)

    def place(self, q: FloatArray) -> None:
        """Put the arm at rest at angles (6,) rad."""
        self._live.place(q)

    def step(self, plan: Plan, h: float) -> Sample:
        """Let h (s) pass while the drives follow the plan, and measure then."""
        return self._live.step(Setpoint(plan.q, plan.qd, plan.qdd), h)

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """M(q) (6, 6) kg·m² after the controller's model."""
        return self.model.mass_matrix(q)

    def coriolis(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """C(q, q̇)·q̇ (6,) N·m after the controller's model."""
        rows = np.array([q, q]), np.array([qd, np.zeros(6)]), np.zeros((2, 6))
        moving, weight = self.model.torques(*rows)
        return np.asarray(moving - weight)
