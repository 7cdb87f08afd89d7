"""The interface of a simulator that is called point by point and cannot be compiled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.tables import ROUNDING, Acceleration

Nodes = tuple[FloatArray, FloatArray]
"""Times and values (m,) of a piecewise linear input; it jumps where a time occurs twice."""


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
