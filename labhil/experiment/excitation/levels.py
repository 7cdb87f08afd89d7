"""Piecewise constant excitations: steps, staircases, random levels, and a constant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf

import numpy as np

from labhil.experiment.excitation.function import Seed


@dataclass(frozen=True, slots=True)
class Steps:
    """``levels`` one after another, each held for ``dwell`` s, repeated from the first."""

    levels: tuple[float, ...]
    dwell: float

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        return self.levels[int(max(t, 0.0) / self.dwell) % len(self.levels)]


@dataclass(frozen=True, slots=True)
class Hold:
    """The constant ``level``."""

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

    It goes both ways so that effects of the direction show; the lowest and the highest level are held once
    per cycle.
    """
    up = _even_levels(low, high, count)
    check_dwell(dwell)
    return Steps((*up, *up[-2:0:-1]), dwell)


def hold(level: float) -> Hold:
    """Return a constant for the whole step."""
    return Hold(level)


def prms(low: float, high: float, count: int, dwell: float, duration: float, seed: Seed = 0) -> Steps:
    """Return a pseudo-random multilevel sequence that lasts ``duration`` s at least.

    It has ``count`` even levels between ``low`` and ``high``, each held for ``dwell`` s. Every round of
    ``count`` holds is a random permutation of the levels, so that even a short sequence covers the whole
    range (independent draws would miss a third of the levels in the first round).
    """
    levels = np.array(_even_levels(low, high, count))
    check_dwell(dwell)
    n_holds = count_holds(duration, dwell)
    rng = np.random.default_rng(seed)
    rounds = [rng.permutation(levels) for _ in range(ceil(n_holds / count))]
    return Steps(tuple(np.concatenate(rounds)[:n_holds].tolist()), dwell)


def count_holds(duration: float, dwell: float, *, max_holds: int = 10_000_000) -> int:
    """Count the holds of ``dwell`` s that fill ``duration`` s; ValueError for more than ``max_holds``."""
    if not 0 < duration < inf:
        raise ValueError(f"`duration` must be positive, found {duration:g}")
    n_holds = ceil(duration / dwell)
    if n_holds > max_holds:
        raise ValueError(
            f"`dwell` of {dwell:g} s makes {n_holds} holds in {duration:g} s; at most {max_holds}"
        )
    return n_holds


def check_dwell(dwell: float) -> None:
    """Raise ValueError unless a hold time (s) is positive and finite."""
    if not 0 < dwell < inf:
        raise ValueError(f"`dwell` must be positive, found {dwell:g}")


def check_order(low: float, high: float) -> None:
    """Raise ValueError unless ``low`` is below ``high``."""
    if not low < high:
        raise ValueError(f"`low` must be smaller than `high`, found {low:g} and {high:g}")


def _even_levels(low: float, high: float, count: int) -> tuple[float, ...]:
    check_order(low, high)
    if count < 2:
        raise ValueError(f"`count` must be two levels at least, found {count}")
    return tuple(float(level) for level in np.linspace(low, high, count))
