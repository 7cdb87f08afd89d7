"""Variables of the stream of a UR driver, and their order."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import itemgetter

from labhil_ur5.reported_signals import REPORTED, TIMESTAMP
from labhil_ur5.rtde import Recipe


def variable_names() -> tuple[list[str], list[str]]:
    """Return the names of required and of optional variables."""
    needed = [TIMESTAMP, *(item.variable for item in REPORTED if not item.optional)]
    return needed, [item.variable for item in REPORTED if item.optional]


def row_reader(recipe: Recipe) -> Callable[[tuple[float, ...]], list[float]]:
    """Return a function that puts the numbers of a package into the order of the stream."""
    indices: list[int] = []
    nan_index = sum(part.stop - part.start for part in recipe.slices.values())
    masks: list[tuple[int, int]] = []
    for item in REPORTED:
        part = recipe.slices.get(item.variable)
        if item.mask:
            masks.append((len(indices), item.mask))
        indices += [nan_index] * item.signal.width if part is None else range(part.start, part.stop)
    select = itemgetter(*indices)

    def read_row(values: tuple[float, ...]) -> list[float]:
        row = list(select((*values, math.nan)))
        for index, mask in masks:
            if row[index] == row[index]:
                row[index] = int(row[index]) & mask
        return row

    return read_row
