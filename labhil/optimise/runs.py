"""Choose the 55 designs to simulate: five parameters at the five levels of Table A.2.

The reference text says 55 simulations "for different combinations" and no more. Ours are:

- 1 centre (all middle levels) and 20 along the axes: each parameter's other four levels, the rest at the
  centre (what Figures A.4 to A.8 show);
- 25 of an orthogonal array of strength two: every pair of levels of every pair of parameters occurs
  exactly once (columns a, b, a+b, a+2b, a+3b over the integers modulo 5; the seed renames the levels);
- 8 corners of a quarter of the 2⁵ factorial, for optima at the bounds;
- the original design of Table A.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.optimise.geometry import LEVELS, ORIGINAL, PARAMETERS
from labhil.signals import FloatArray

COUNT = 55


@dataclass(frozen=True, slots=True)
class Runs:
    """Designs to simulate, and the reason for each."""

    designs: FloatArray
    """(55, 5) in m and rad."""
    kinds: tuple[str, ...]
    """``centre``, ``axis``, ``pairs``, ``corner`` or ``original``, per row."""


def design_runs(seed: int = 0) -> Runs:
    """Return the 55 distinct runs; the seed permutes the levels of the orthogonal array."""
    rng = np.random.default_rng(seed)
    fixed = np.vstack([_axis_points(), _corners(), _nearest_levels(ORIGINAL)])
    while True:
        levels = np.vstack([fixed, _orthogonal_array(rng)])
        if len(np.unique(levels, axis=0)) == COUNT:
            break
    kinds = ("centre", *["axis"] * 20, *["corner"] * 8, "original", *["pairs"] * 25)
    return Runs(LEVELS[np.arange(len(PARAMETERS)), levels], kinds)


def _axis_points() -> np.ndarray[tuple[int, int], np.dtype[np.int_]]:
    moved = [(j, level) for j in range(5) for level in (0, 1, 3, 4)]
    return np.array([[2] * 5, *([level if k == j else 2 for k in range(5)] for j, level in moved)])


def _corners() -> np.ndarray[tuple[int, int], np.dtype[np.int_]]:
    """Resolution III: the fourth factor is the product of the first two, the fifth of first and third."""
    a, b, c = (grid.ravel() for grid in np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"))
    return np.asarray(4 * np.stack([a, b, c, 1 - (a ^ b), 1 - (a ^ c)], axis=1))


def _orthogonal_array(rng: np.random.Generator) -> np.ndarray[tuple[int, int], np.dtype[np.int_]]:
    a, b = (grid.ravel() for grid in np.meshgrid(np.arange(5), np.arange(5), indexing="ij"))
    columns = [a, b, (a + b) % 5, (a + 2 * b) % 5, (a + 3 * b) % 5]
    return np.stack([rng.permutation(5)[column] for column in columns], axis=1)


def _nearest_levels(design: FloatArray) -> np.ndarray[tuple[int, int], np.dtype[np.int_]]:
    return np.argmin(np.abs(LEVELS - design[:, None]), axis=1)[None, :]
