"""Which variables of a controller the stream of a UR driver is made of, and in which order it holds them."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import itemgetter

from labhil_ur5.declared import REPORTED, TIMESTAMP
from labhil_ur5.rtde import Recipe


def variables() -> tuple[list[str], list[str]]:
    """Return the names of the variables that are needed, and of those that are optional."""
    needed = [TIMESTAMP, *(item.variable for item in REPORTED if not item.optional)]
    return needed, [item.variable for item in REPORTED if item.optional]


def in_stream_order(recipe: Recipe) -> Callable[[tuple[float, ...]], list[float]]:
    """Return what brings the numbers of a package into the order of the stream."""
    places: list[int] = []
    absent = sum(part.stop - part.start for part in recipe.slices.values())
    masks: list[tuple[int, int]] = []
    for item in REPORTED:
        part = recipe.slices.get(item.variable)
        if item.mask:
            masks.append((len(places), item.mask))
        places += [absent] * item.signal.width if part is None else range(part.start, part.stop)
    pick = itemgetter(*places)

    def take(values: tuple[float, ...]) -> list[float]:
        row = list(pick((*values, math.nan)))
        for place, mask in masks:
            if row[place] == row[place]:
                row[place] = int(row[place]) & mask
        return row

    return take
