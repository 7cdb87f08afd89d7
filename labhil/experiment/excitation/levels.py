"""Levels that are held: steps, staircases, random ones, and a single one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf

import numpy as np

from labhil.experiment.excitation.function import Seed

MOST_HOLDS = 10_000_000


@dataclass(frozen=True, slots=True)
class Steps:
    """``levels`` one after another, each held for ``dwell`` s, and again from the first."""

    levels: tuple[float, ...]
    dwell: float

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        return self.levels[int(max(t, 0.0) / self.dwell) % len(self.levels)]


@dataclass(frozen=True, slots=True)
class Hold:
    """One value, ``level``, all the time."""

    level: float

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        return self.level


def steps(levels: Sequence[float], dwell: float) -> Steps:
    """Return ``levels`` one after another, each held for ``dwell`` s."""
    if not levels:
        raise ValueError("`levels` is empty; steps takes at least one")
    check_dwell(dwell)
    return Steps(tuple(levels), dwell)


def staircase(low: float, high: float, count: int, dwell: float) -> Steps:
    """Return ``count`` even levels from ``low`` up to ``high`` and down again, each held for ``dwell`` s.

    Both ways, so that what depends on the direction shows; the two ends are held once a turn.
    """
    up = _ladder(low, high, count)
    check_dwell(dwell)
    return Steps((*up, *up[-2:0:-1]), dwell)


def hold(level: float) -> Hold:
    """Return one value for the whole step."""
    return Hold(level)


def prms(low: float, high: float, count: int, dwell: float, duration: float, seed: Seed = 0) -> Steps:
    """Return a pseudo-random multilevel sequence that lasts ``duration`` s at least.

    ``count`` even levels between ``low`` and ``high``, each held for ``dwell`` s. They come in rounds:
    each round holds every level once, in an order of its own, so that even a short sequence visits the
    whole range (drawing each anew would leave out every third level of a first round).
    """
    ladder = np.array(_ladder(low, high, count))
    check_dwell(dwell)
    holds = holds_in(duration, dwell)
    draw = np.random.default_rng(seed)
    rounds = [draw.permutation(ladder) for _ in range(ceil(holds / count))]
    return Steps(tuple(np.concatenate(rounds)[:holds].tolist()), dwell)


def holds_in(duration: float, dwell: float) -> int:
    """Return how many holds of ``dwell`` s fill ``duration`` s; ValueError when they are too many."""
    if not 0 < duration < inf:
        raise ValueError(f"`duration` must be positive, found {duration:g}")
    holds = ceil(duration / dwell)
    if holds > MOST_HOLDS:
        raise ValueError(
            f"`dwell` of {dwell:g} s makes {holds} holds in {duration:g} s; at most {MOST_HOLDS}"
        )
    return holds


def check_dwell(dwell: float) -> None:
    """Raise ValueError for a hold time (s) that is none."""
    if not 0 < dwell < inf:
        raise ValueError(f"`dwell` must be positive, found {dwell:g}")


def check_ends(low: float, high: float) -> None:
    """Raise ValueError unless ``low`` is below ``high``."""
    if not low < high:
        raise ValueError(f"`low` must be smaller than `high`, found {low:g} and {high:g}")


def _ladder(low: float, high: float, count: int) -> tuple[float, ...]:
    check_ends(low, high)
    if count < 2:
        raise ValueError(f"`count` must be two levels at least, found {count}")
    return tuple(float(level) for level in np.linspace(low, high, count))
