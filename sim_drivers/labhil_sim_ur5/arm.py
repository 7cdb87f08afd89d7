"""The arm of the controller: a plan in, the readings of its sensors out."""

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
    """The simulated UR5: rigid links, friction, temperature and sensors.

    Args:
        parameters: Parameters of the plant by name, other than its defaults.
        terms: Names of its effects.
        seed: Seed of its noise.
    """

    def __init__(self, parameters: Mapping[str, float], terms: tuple[str, ...], seed: int) -> None:
        self.links = UR5
        self._live = LiveArm(parameters, terms, seed, UR5)

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters of the plant by key."""
        return self._live.parameters

    @property
    def torque_constant(self) -> FloatArray:
        """Torque constants at the joints (6,), N·m/A."""
        return self._live.torque_constant

    @property
    def model(self) -> RecursiveBody:
        """The controller's model of the arm with its payload."""
        return self._live.expected()

    def expect(self, mass: float, centre: Point, gravity: Point) -> None:
        """Set mass (kg) and centre (m) of the payload and gravity (m/s²) in the controller's model."""
        self._live.set_expected_load(mass, centre, gravity)

    def place(self, q: FloatArray) -> None:
        """Place the arm at rest at angles (6,) rad."""
        self._live.place(q)

    def step(self, plan: Plan, h: float) -> Sample:
        """Advance by h (s) while the drives follow the plan, and return the measurement."""
        return self._live.step(Setpoint(plan.q, plan.qd, plan.qdd), h)

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Return M(q) (6, 6), kg·m², of the controller's model."""
        return self.model.mass_matrix(q)

    def coriolis(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return C(q, q̇)·q̇ (6,), N·m, of the controller's model."""
        rows = np.array([q, q]), np.array([qd, np.zeros(6)]), np.zeros((2, 6))
        with_motion, gravity = self.model.torques(*rows)
        return np.asarray(with_motion - gravity)
