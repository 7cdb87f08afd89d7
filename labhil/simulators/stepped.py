"""The interface of a simulator that is called point by point and cannot be compiled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Protocol

import numpy as np

from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.tables import ROUNDING, Acceleration

Nodes = tuple[FloatArray, FloatArray]
"""Times and values (m,) of a piecewise linear input; it jumps where a time occurs twice."""


MAX_STEP = 2e-3
"""Longest step under an added force, and of an integration by labhil, s."""


@dataclass(frozen=True, slots=True)
class NonSmooth:
    """Properties of a simulator that its smooth acceleration does not contain.

    Attributes:
        stops: End stops of the position.
        clip: Limits of the input.
        delay: Delay of the input, s.
        rounding: Share of its acceleration below which its own solver is not accurate.
    """

    stops: tuple[float, float] = (-np.inf, np.inf)
    clip: tuple[float, float] = (-np.inf, np.inf)
    delay: float = 0.0
    rounding: float = ROUNDING


JointForce = Callable[[float, float, float, float], float]
"""(time of the recording, position, velocity, force of the actuator or input) to an additional force at the
joint."""


@dataclass(slots=True)
class AddedForce:
    """A force that is added to a simulator in a roll-out.

    Attributes:
        force: The force, in units of the input where it acts like the input; None where there is none.
        substeps: Number by which the steps of the roll-out are divided.
    """

    force: JointForce | None = None
    substeps: int = 1

    def at(self, t: float, state: Sequence[float] | FloatArray, drive: float) -> float:
        """Return the force at a time of the recording and a state under an input."""
        return 0.0 if self.force is None else self.force(t, float(state[0]), float(state[1]), drive)

    def parts(self, length: float) -> int:
        """Return the number of steps for a time in s."""
        return self.substeps * max(1, ceil(length / MAX_STEP))


class SteppedSimulator(Protocol):
    """A simulator of one coordinate that can only be called."""

    @property
    def non_smooth(self) -> NonSmooth:
        """Stops, limits and delay."""
        ...

    def acceleration_at(self, numbers: Sequence[float]) -> Acceleration:
        """Return the smooth acceleration at these values of its parameters, in their order."""
        ...

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """Return the generalised force per acceleration; None where forces act like the input."""
        ...

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Step all windows with everything that the simulator contains.

        Args:
            numbers: Values of its parameters.
            record: The recording.
            nodes: Times and values of the input.
            windows: w windows of the recording, N samples in total.
            states: Position and velocity at the start of each window, (w, 2).

        Returns:
            Position and velocity, (N, 2).
        """
        ...
