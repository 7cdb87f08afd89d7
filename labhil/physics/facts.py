"""What physics knows of a rig's recording before anything is fitted: figures with bounds, and how they scale.

A fact is a figure that is made of signals (the largest position, the acceleration per radian, the sampling
rate). It knows by which power of each signal's unit it scales, so that what a wrong unit, sign or time would
have made of it is arithmetic. The facts of a kind of rig stand in a file of its own beside its model
(``ball_beam_facts`` …); ``identify.plausibility`` draws the conclusions. Nothing here is compiled, since
``labhil import`` looks at facts too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labhil.physics.model import Record
from labhil.signals import FloatArray

TIME = "t"

LENGTHS = (8, 16, 32, 64, 128, 256)
"""Samples in the stretches of a regression: in samples, so that a wrong unit of time changes no choice."""

CERTAIN = 10.0
"""Standard errors from zero at which a slope counts: residuals are correlated, so errors look too small."""

HOLE = 3.0
"""Usual steps of time from which one is a hole: what the signals did in it is not known."""

LEAST_R2 = 0.5
"""Share of the variance that a regression has to explain for its slopes to mean anything."""


@dataclass(frozen=True, slots=True)
class Fact:
    """One figure of a recording with the bounds that physics sets.

    ``powers`` say how ``value`` scales with each signal ("t" for the time); ``typical`` is what it mostly is,
    for choosing among explanations, ``because`` a reason for the bounds. ``dynamic`` facts compare signals,
    ``unsigned`` ones are sizes, of which signs make nothing else.
    """

    what: str
    value: float
    unit: str
    low: float
    high: float
    powers: Mapping[str, int]
    because: str
    typical: float | None = None
    dynamic: bool = False
    unsigned: bool = False

    def holds(self, factors: Mapping[str, float] | None = None) -> bool:
        """Whether the value is within the bounds, its signals multiplied by these ``factors``."""
        return self.low < self.scaled(factors or {}) <= self.high

    def scaled(self, factors: Mapping[str, float]) -> float:
        """The value that signals multiplied by these ``factors`` would have given."""
        value = self.value
        for name, factor in factors.items():
            value *= float(factor) ** self.powers.get(name, 0)
        return abs(value) if self.unsigned else value


def rate_fact(record: Record, low: float, high: float, typical: float = 100.0) -> Fact:
    """The sampling rate, Hz."""
    why = f"such a rig is sampled at {low:g} to {high:g} Hz"
    return Fact("the sampling rate", 1.0 / record.period, "Hz", low, high, {TIME: -1}, why, typical)


def size_fact(name: str, unit: str, values: FloatArray, high: float, typical: float, because: str) -> Fact:
    """The largest absolute value of a signal (…); one sample in a thousand may stray."""
    largest = float(np.quantile(np.abs(values), 0.999))
    return Fact(
        f"the largest {name}", largest, unit, -1.0, high, {name: 1}, because, typical, unsigned=True
    )  # fmt: skip


def rate_of_change_fact(t: FloatArray, position: str, x: FloatArray, rate: str, v: FloatArray) -> list[Fact]:
    """That a measured rate (n, …) is the derivative of a measured position (n, …), where both move."""
    complete = ~_holes(t)
    step = np.diff(t)[complete, None] if x.ndim > 1 else np.diff(t)[complete]
    moved, by_rate = np.diff(x, axis=0)[complete], 0.5 * step * (v[1:] + v[:-1])[complete]
    power = float(np.sum(by_rate**2))
    if not power > 0.0 or not np.any(moved):
        return []
    slope = float(np.sum(moved * by_rate)) / power
    correlation = float(np.sum(moved * by_rate)) / np.sqrt(power * float(np.sum(moved**2)))
    if abs(correlation) < np.sqrt(LEAST_R2):
        return []
    what = f"the change of {position} over what {rate} adds up to"
    powers = {position: 1, rate: -1, TIME: -1}
    return [Fact(what, slope, "", 0.7, 1.4, powers, "one is the derivative of the other", 1.0, dynamic=True)]


def _holes(t: FloatArray) -> np.ndarray:
    """Which steps of time (n − 1,) are holes."""
    step = np.diff(t)
    return np.asarray(step > HOLE * np.median(step))


def integral(t: FloatArray, x: FloatArray, *, held: bool = False) -> FloatArray:
    """The running integral (n,) of x, which is held or straight between samples."""
    pieces = x[:-1] if held else 0.5 * (x[1:] + x[:-1])
    return np.r_[0.0, np.cumsum(np.diff(t) * pieces)]


def slopes(
    target: FloatArray, columns: Sequence[FloatArray], t: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Slopes of a regression on short stretches, and how many standard errors each is from zero.

    Each stretch has a polynomial in time (``degree`` 0 or 1) of its own, so that how it began does not count;
    those with a hole in time do not count. Of several lengths the one whose first slope is most certain is
    taken. Slopes are (columns,); the second array is zero where too little is explained.
    """
    best = np.zeros(len(columns)), np.zeros(len(columns))
    for length in LENGTHS:
        count = len(t) // length
        if count < 2 or length <= degree + 1 + len(columns):
            continue
        candidate = _slopes(target, columns, t, degree, (count, length))
        if candidate is not None and abs(candidate[1][0]) > abs(best[1][0]):
            best = candidate
    return best


def _slopes(
    target: FloatArray, columns: Sequence[FloatArray], t: FloatArray, degree: int, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray] | None:
    count, length = shape
    complete = ~np.r_[_holes(t), False][: count * length].reshape(count, length)[:, :-1].any(axis=1)
    samples = np.column_stack([target, *columns])[: count * length].reshape(count, length, -1)[complete]
    time = t[: count * length].reshape(count, length)[complete]
    count = len(time)
    if count < 2:
        return None
    time = (time - time[:, :1]) / max(float(np.mean(time[:, -1] - time[:, 0])), 1e-300)
    basis, _ = np.linalg.qr(np.stack([time**k for k in range(degree + 1)], axis=2))
    apart = (samples - basis @ (np.swapaxes(basis, 1, 2) @ samples)).reshape(count * length, -1)
    y, design = apart[:, 0], apart[:, 1:]
    norms = np.linalg.norm(design, axis=0)
    total = float(y @ y)
    if not np.all(norms > 0.0) or not np.isfinite(total) or not total > 0.0:
        return None
    design = design / norms
    factors, _, rank, _ = np.linalg.lstsq(design, y, rcond=1e-9)
    residuals = y - design @ factors
    if rank < len(norms) or float(residuals @ residuals) > (1.0 - LEAST_R2) * total:
        return None
    freedom = max(count * (length - degree - 1) - len(norms), 1)
    errors = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * float(residuals @ residuals) / freedom)
    return factors / norms, factors / np.maximum(errors, 1e-300)


def second_order_gain(t: FloatArray, u: FloatArray, x: FloatArray) -> float | None:
    """Acceleration of x per unit of u, by ẍ = g·u + c − d·ẋ; None where the recording does not show it.

    Positions are compared with double integrals, so no derivative of a noisy signal is needed.
    """
    push, drag = integral(t, integral(t, u)), integral(t, x)
    (gain, *_), (certainty, *_) = slopes(x, [push, 0.5 * (t - t[0]) ** 2, drag], t, 1)
    return float(gain) if abs(certainty) > CERTAIN else None
