"""Plausibility figures of a recording that need no fit, with physical bounds and their scaling with units.

A fact is a figure computed from signals (the largest position, the acceleration per radian, the sampling
rate). It states with which power of each signal's unit it scales, so the effect of a wrong unit, sign or time
base can be computed. The facts of each rig kind are in a file beside its model (``ball_beam_facts`` …);
``identify.plausibility`` draws the conclusions. Nothing here is compiled, since ``labhil import`` uses facts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labhil.physics.record import Record
from labhil.signals import FloatArray

TIME = "t"
"""Name of the time among the powers of a fact."""

MIN_T_RATIO = 10.0
"""Least |slope|/standard error of a slope that counts; high, since correlated residuals make errors small."""

MIN_R_SQUARED = 0.5
"""Least coefficient of determination R² of a regression whose slopes count."""


@dataclass(frozen=True, slots=True)
class Fact:
    """One figure of a recording with its physical bounds.

    Attributes:
        what: The figure in words.
        value: Its value.
        unit: Its unit.
        low: Lower bound, excluded.
        high: Upper bound, included.
        powers: Power of each signal ("t" for the time) with which the value scales.
        because: Reason for the bounds.
        typical: Usual value, for the choice among explanations.
        dynamic: True if it compares signals with each other.
        unsigned: True for an absolute value, which a change of sign does not affect.
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
        """Whether the value is within the bounds after its signals are multiplied by ``factors``."""
        return self.low < self.scaled(factors or {}) <= self.high

    def scaled(self, factors: Mapping[str, float]) -> float:
        """The value after its signals are multiplied by ``factors``."""
        value = self.value
        for name, factor in factors.items():
            value *= float(factor) ** self.powers.get(name, 0)
        return abs(value) if self.unsigned else value


def sampling_rate_fact(record: Record, low: float, high: float, typical: float = 100.0) -> Fact:
    """Make the fact of the sampling rate, Hz, with bounds ``low`` and ``high``."""
    why = f"such a rig is sampled at {low:g} to {high:g} Hz"
    return Fact("the sampling rate", 1.0 / record.period, "Hz", low, high, {TIME: -1}, why, typical)


def amplitude_fact(
    name: str, unit: str, values: FloatArray, high: float, typical: float, because: str
) -> Fact:
    """Make the fact of the largest absolute value of a signal; one sample in a thousand may exceed it."""
    largest = float(np.quantile(np.abs(values), 0.999))
    return Fact(
        f"the largest {name}", largest, unit, -1.0, high, {name: 1}, because, typical, unsigned=True
    )  # fmt: skip


def derivative_fact(t: FloatArray, position: str, x: FloatArray, rate: str, v: FloatArray) -> list[Fact]:
    """Make the fact that a measured rate (n, …) is the derivative of a measured position (n, …).

    The list is empty unless both move and are correlated.
    """
    complete = ~_holes(t)
    step = np.diff(t)[complete, None] if x.ndim > 1 else np.diff(t)[complete]
    moved, by_rate = np.diff(x, axis=0)[complete], 0.5 * step * (v[1:] + v[:-1])[complete]
    power = float(np.sum(by_rate**2))
    if not power > 0.0 or not np.any(moved):
        return []
    slope = float(np.sum(moved * by_rate)) / power
    correlation = float(np.sum(moved * by_rate)) / np.sqrt(power * float(np.sum(moved**2)))
    if abs(correlation) < np.sqrt(MIN_R_SQUARED):
        return []
    what = f"the change of {position} over what {rate} adds up to"
    powers = {position: 1, rate: -1, TIME: -1}
    return [Fact(what, slope, "", 0.7, 1.4, powers, "one is the derivative of the other", 1.0, dynamic=True)]


def _holes(t: FloatArray, *, max_periods: float = 3.0) -> np.ndarray:
    """Mark gaps in time: steps (n − 1,) longer than ``max_periods`` median periods."""
    step = np.diff(t)
    return np.asarray(step > max_periods * np.median(step))


def running_integral(t: FloatArray, x: FloatArray, *, held: bool = False) -> FloatArray:
    """Running integral (n,) of x, which is held or linear between samples."""
    pieces = x[:-1] if held else 0.5 * (x[1:] + x[:-1])
    return np.r_[0.0, np.cumsum(np.diff(t) * pieces)]


def regress_stretches(
    target: FloatArray,
    columns: Sequence[FloatArray],
    t: FloatArray,
    degree: int,
    *,
    lengths: Sequence[int] = (8, 16, 32, 64, 128, 256),
) -> tuple[FloatArray, FloatArray]:
    """Regress a target on columns over short stretches of a recording.

    Each stretch has its own polynomial in time, which absorbs initial values; stretches with a gap in time
    are left out. Of all lengths, the one with the largest t ratio of the first slope is taken.

    Args:
        target: What is regressed, (n,).
        columns: Regressors, each (n,).
        t: Times, (n,), s.
        degree: Degree of the polynomial, 0 or 1.
        lengths: Lengths of the stretches, in samples, so a wrong unit of time does not change the choice.

    Returns:
        Slopes and their t ratios, (columns,) each; zeros where the regression explains too little.
    """
    best = np.zeros(len(columns)), np.zeros(len(columns))
    for length in lengths:
        count = len(t) // length
        if count < 2 or length <= degree + 1 + len(columns):
            continue
        candidate = _regress(target, columns, t, degree, (count, length))
        if candidate is not None and abs(candidate[1][0]) > abs(best[1][0]):
            best = candidate
    return best


def _regress(
    target: FloatArray, columns: Sequence[FloatArray], t: FloatArray, degree: int, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray] | None:
    """Slopes and t ratios for ``shape`` = (stretches, samples in each); None if it explains too little."""
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
    if rank < len(norms) or float(residuals @ residuals) > (1.0 - MIN_R_SQUARED) * total:
        return None
    freedom = max(count * (length - degree - 1) - len(norms), 1)
    errors = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * float(residuals @ residuals) / freedom)
    return factors / norms, factors / np.maximum(errors, 1e-300)


def second_order_gain(t: FloatArray, u: FloatArray, x: FloatArray) -> float | None:
    """Estimate the gain g of ẍ = g·u + c − d·ẋ by a regression on double integrals.

    Args:
        t: Times, (n,), s.
        u: Input, (n,).
        x: Position, (n,).

    Returns:
        Acceleration of x per unit of u; None if its t ratio is below ``MIN_T_RATIO``.
    """
    push, drag = running_integral(t, running_integral(t, u)), running_integral(t, x)
    (gain, *_), (certainty, *_) = regress_stretches(x, [push, 0.5 * (t - t[0]) ** 2, drag], t, 1)
    return float(gain) if abs(certainty) > MIN_T_RATIO else None
