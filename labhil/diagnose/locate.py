"""Where a mismatch lives: in time, and along the physical coordinate that reveals it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.score import Score
from labhil.signals import FloatArray

SHARE = 0.8
BINS = 40
COORDINATE_UNITS = {
    "ball_position": "m",
    "ball_velocity": "m/s",
    "servo_angle": "rad",
    "beam_angle": "rad",
    "servo_angle_rate": "rad/s",
    "beam_angle_rate": "rad/s",
}


@dataclass(frozen=True, slots=True)
class Regime:
    """A range of a coordinate, with the share of the excess squared error in it."""

    coordinate: str
    low: float
    high: float
    share_of_excess: float


@dataclass(frozen=True, slots=True)
class Location:
    """Where the excess error is; ``enters`` says at which place of the chain the missing effect acts."""

    channel: str
    joint: int | None
    enters: str
    times: tuple[tuple[float, float], ...]
    regimes: tuple[Regime, ...]
    statement: str


def contribution(final: Fitted, term: str) -> tuple[Mapping[str, FloatArray], FloatArray]:
    """Coordinates along the model's windows, and the effort that one of its terms contributes there, (N,).

    A term on the way in changes what the same effort law is fed with; one on the way out contributes
    no effort at all.
    """
    model, problem = final.problem.model, final.problem
    states = final.solution.point.states
    less = final.theta.copy()
    for i, parameter in enumerate(model.parameters):
        if parameter.term == term and not parameter.shape:
            less[i] = 0.0
    whole = model.coordinates(final.theta, problem.record, problem.windows, states)
    path = model.coordinates(less, problem.record, problem.windows, states)
    fed = {**whole, "beam_sine": path["beam_sine"], "beam_rate": path["beam_rate"]}
    return whole, model.effort(final.theta, whole) - model.effort(less, fed)


def where(final: Fitted, term: str) -> list[tuple[str, Regime]]:
    """The term with the sharpest regime of its contribution, if it has any."""
    coordinates, effort = contribution(final, term)
    return [(term, regime) for regime in regimes(coordinates, effort**2)[:1]]


def regimes(coordinates: Mapping[str, FloatArray], excess: FloatArray) -> tuple[Regime, ...]:
    """The smallest stretch of each coordinate that holds 80 % of ``excess`` (N,), the sharpest first.

    Only coordinates along which it holds clearly fewer than 60 % of the samples are named.
    """
    found = []
    for name, values in coordinates.items():
        if name not in COORDINATE_UNITS or np.ptp(values) <= 0:
            continue
        low, high, samples = _smallest_stretch(values, excess)
        inside = (values >= low) & (values <= high)
        share = float(excess[inside].sum() / max(float(excess.sum()), 1e-300))
        if samples < 0.6:
            found.append((samples, Regime(name, low, high, share)))
    return tuple(regime for _, regime in sorted(found, key=lambda item: item[0]))


def _smallest_stretch(values: FloatArray, excess: FloatArray) -> tuple[float, float, float]:
    """Bounds of the contiguous run of bins with the fewest samples that holds the share, and that share."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    weight = np.bincount(place, excess, len(edges) - 1)
    count = np.bincount(place, minlength=len(edges) - 1) / len(values)
    total = float(weight.sum())
    best = (float(edges[0]), float(edges[-1]), 1.0)
    sums, counts = np.r_[0.0, np.cumsum(weight)], np.r_[0.0, np.cumsum(count)]
    for i in range(len(edges) - 1):
        j = int(np.searchsorted(sums, sums[i] + SHARE * total))
        if j < len(edges) and counts[j] - counts[i] < best[2]:
            best = (float(edges[i]), float(edges[j]), float(counts[j] - counts[i]))
    return best


def times(before: Score, after: Score, t: FloatArray, most: int = 5) -> tuple[tuple[float, float], ...]:
    """The scored windows that together hold half of the excess squared error, worst first, s."""
    excess = (before.errors**2).sum(axis=1) - (after.errors**2).sum(axis=1)
    owners = np.unique(before.window)
    sums = np.array([excess[before.window == w].sum() for w in owners])
    order = np.argsort(sums)[::-1]
    spans, held = [], 0.0
    for i in order[:most]:
        if sums[i] <= 0 or held > 0.5 * sums[sums > 0].sum():
            break
        rows = before.rows[before.window == owners[i]]
        spans.append((float(t[rows[0]]), float(t[rows[-1]])))
        held += float(sums[i])
    return tuple(spans)


def statement(channel: str, strongest: str, enters: str, lives: Sequence[tuple[str, Regime]]) -> str:
    """One plain sentence: which effect is the strongest, where it enters, and where an effect lives."""
    begin = f"What {channel} is off by enters by the {enters} (most of it {strongest})"
    if not lives:
        return f"{begin} and is spread over all regimes that were visited."
    term, regime = lives[0]
    unit = COORDINATE_UNITS[regime.coordinate]
    return (
        f"{begin}; {regime.share_of_excess:.0%} of {term} lives at {regime.coordinate} "
        f"between {regime.low:.3g} and {regime.high:.3g} {unit}."
    )
