"""The interface of a simulator that is stepped or called and cannot be compiled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from labhil.physics.model import Record, Windows
from labhil.signals import FloatArray
from labhil.simulators.tables import NEGLIGIBLE, Ask

Nodes = tuple[FloatArray, FloatArray]
"""Times and values (m,) of an input that is straight in between; it jumps where a time is there twice."""


@dataclass(frozen=True, slots=True)
class Held:
    """What of a simulator is no smooth acceleration, and is solved apart from it.

    ``stops`` are the ends of its way, ``clip`` what its input is clipped to, ``delay`` (s) by how much that
    acts late. ``rough`` is the share of its acceleration below which its own solver is not to be believed.
    """

    stops: tuple[float, float] = (-np.inf, np.inf)
    clip: tuple[float, float] = (-np.inf, np.inf)
    delay: float = 0.0
    rough: float = NEGLIGIBLE


class Stepped(Protocol):
    """A simulator of one coordinate that answers only when it is called."""

    @property
    def held(self) -> Held:
        """What is solved apart."""
        ...

    def ask(self, numbers: Sequence[float]) -> Ask:
        """Its smooth acceleration at these values of its parameters, in their order."""
        ...

    def inertia(self, numbers: Sequence[float]) -> float | None:
        """What a force at the coordinate is divided by; None where only its input is known to push."""
        ...

    def roll_out(
        self, numbers: Sequence[float], record: Record, nodes: Nodes, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity (N, 2) of all windows as the simulator itself steps them, with all it has."""
        ...
