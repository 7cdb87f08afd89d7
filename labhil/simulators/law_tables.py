"""Write a user's own friction law as a table over speed, for a companion that needs no other package."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import wrap
from typing import NamedTuple

import numpy as np

from labhil.physics.friction_law import GRID, FrictionLaw
from labhil.signals import FloatArray

TOLERANCE = 2e-3
"""Largest error of a table between its speeds, relative to the force there."""

SLOW = 1e-3
"""Speed (m/s or rad/s) below which the error is relative to the force at this speed."""

INTERPOLATE = """def interpolate(speeds, forces, speed):
    \"\"\"The force at a speed; beyond the last one that of the last.\"\"\"
    if speed >= speeds[-1]:
        return forces[-1]
    k = bisect(speeds, speed)
    share = (speed - speeds[k - 1]) / (speeds[k] - speeds[k - 1])
    return forces[k - 1] + share * (forces[k] - forces[k - 1])
"""


class LawTable(NamedTuple):
    """A law at its values: c·g at speeds that are enough for a linear interpolation."""

    law: FrictionLaw
    speeds: FloatArray
    forces: FloatArray

    @classmethod
    def of(cls, law: FrictionLaw, values: Mapping[str, float]) -> LawTable:
        """Tabulate a law.

        Args:
            law: The law.
            values: Coefficient and shape by the part of their names after the dot.
        """
        forces = law.force(GRID, lambda key: values.get(key.partition(".")[2], 0.0))
        slow = abs(float(np.interp(SLOW, GRID, forces)))
        chosen = enough_nodes(GRID, forces, TOLERANCE * np.maximum(np.abs(forces), slow))
        return cls(law, GRID[chosen], forces[chosen])

    @property
    def name(self) -> str:
        """The name of the table in the companion."""
        return self.law.name.upper()

    def text(self, width: int) -> list[str]:
        """Return the lines of the table."""
        rows = [", ".join(f"{number:.6g}" for number in numbers) for numbers in (self.speeds, self.forces)]
        lines = [f"{self.name} = (  # {self.law.equation}: speeds, and the force at each"]
        for row in rows:
            lines += ["    (", *(f"        {line}" for line in wrap(row, width - 8)), "    ),"]
        return [*lines, ")"]


def enough_nodes(x: FloatArray, y: FloatArray, allowed: FloatArray) -> list[int]:
    """Choose nodes such that the straight lines between them pass all others closely enough.

    Args:
        x: Places (n,), rising.
        y: Values (n,).
        allowed: Largest error at each place, (n,).

    Returns:
        Indices of the nodes, in rising order, with both ends.
    """
    chosen = [0]
    while chosen[-1] < len(x) - 1:
        first, last = chosen[-1], chosen[-1] + 1
        while last + 1 < len(x) and _is_straight(x, y, allowed, first, last + 1):
            last += 1
        chosen.append(last)
    return chosen


def _is_straight(x: FloatArray, y: FloatArray, allowed: FloatArray, first: int, last: int) -> bool:
    """Whether the nodes between two others are on the line through them."""
    between = slice(first + 1, last)
    line = np.interp(x[between], x[[first, last]], y[[first, last]])
    return bool(np.all(np.abs(line - y[between]) <= allowed[between]))
