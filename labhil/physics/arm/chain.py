"""Interface between the model of an arm and its rigid bodies.

It is implemented by ``Links`` (six Denavit-Hartenberg rows) and ``Tree`` (any arrangement of hinges).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from labhil.signals import FloatArray


class Chain(Protocol):
    """Rigid links, one after each of n joints, with ten inertial parameters each."""

    @property
    def joints(self) -> int:
        """Number n of joints."""
        ...

    @property
    def inertial(self) -> FloatArray | None:
        """Known inertial parameters (10 n,); None if they are estimated."""
        ...

    @property
    def begin(self) -> FloatArray:
        """Prior inertial parameters (10 n,) of an estimate; zero where nothing is known."""
        ...

    def loaded(self, link: int) -> Sequence[int]:
        """Joints that a link loads: those between the base and the link."""
        ...

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray) -> FloatArray:
        """Torque per inertial parameter (m, n, 10 n) of a motion (m, n); ``gravity`` (3,), m/s²."""
        ...

    def torques(
        self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray, inertial: FloatArray
    ) -> FloatArray:
        """Torques (m, n), N·m, of a motion at inertial parameters (10 n,); much faster than the regressor."""
        ...
