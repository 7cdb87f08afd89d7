"""What the model of an arm needs to know of its rigid bodies, wherever they are described.

``Links`` are six Denavit-Hartenberg rows; ``Tree`` is any arrangement of hinges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from labhil.signals import FloatArray


class Chain(Protocol):
    """Rigid links, one behind each of n joints, with ten inertial parameters each."""

    @property
    def joints(self) -> int:
        """Number n of joints."""
        ...

    @property
    def inertial(self) -> FloatArray | None:
        """Inertial parameters (10 n,) that are known; None where they are to be estimated."""
        ...

    @property
    def begin(self) -> FloatArray:
        """Inertial parameters (10 n,) from which an estimate departs; zero where nothing is known."""
        ...

    def loaded(self, link: int) -> Sequence[int]:
        """Joints that a link loads: those between it and the base."""
        ...

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray) -> FloatArray:
        """Torque per inertial parameter (m, n, 10 n) of a motion (m, n); ``gravity`` (3,) in the base."""
        ...

    def torques(
        self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray, inertial: FloatArray
    ) -> FloatArray:
        """Torques (m, n) of a motion at these inertial parameters (10 n,): much faster than the regressor."""
        ...
