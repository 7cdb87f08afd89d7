"""Trajectories of an arm's joints as Fourier series that begin and end at rest.

Every joint moves on q(t) = ``centre`` + Σ_k a_k/(kω)·sin(kωt) − b_k/(kω)·cos(kωt), ω = 2π times the base
frequency (Swevers et al. 1997: periodic, band-limited, with exact velocities and accelerations). Here
Σ a_k = 0, Σ k·b_k = 0 and Σ b_k/k = 0, so that the joint rests at ``centre`` with zero acceleration at every
beginning of a period, which is where a robot can be brought before the run and stops after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, isfinite, pi, sin

import numpy as np

from labhil.experiment.excitation.function import Excitations, Seed
from labhil.signals import FloatArray

MIN_HARMONICS = 3
"""With fewer no cosine coefficients meet both of their conditions."""
REST_TOLERANCE = 1e-6
"""Relative tolerance of whole numbers of periods, and of zero velocity and acceleration where they begin."""
ROUNDING = 1 - 1e-9
"""Factor on a scaled trajectory that keeps rounding from passing a limit."""


@dataclass(frozen=True, slots=True)
class FourierSeries:
    """The trajectory of one joint; ``sine`` are the a_k and ``cosine`` the b_k in unit/s, k = 1, 2, …"""

    centre: float
    base_frequency: float
    sine: tuple[float, ...]
    cosine: tuple[float, ...]

    def __call__(self, t: float) -> float:
        """Return the position at time ``t`` s."""
        total, base = self.centre, 2 * pi * self.base_frequency
        for k, (a, b) in enumerate(zip(self.sine, self.cosine, strict=True), start=1):
            total += (a * sin(k * base * t) - b * cos(k * base * t)) / (k * base)
        return total


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Limits of one joint: ``low`` to ``high`` around ``centre``, ``speed``, ``acceleration``; SI units."""

    low: float
    high: float
    speed: float
    acceleration: float
    centre: float

    def __post_init__(self) -> None:
        if not self.low < self.centre < self.high:
            actual = f"{self.centre:g} between {self.low:g} and {self.high:g}"
            raise ValueError(f"`centre` must lie between `low` and `high`, found {actual}")
        for name, value in (("speed", self.speed), ("acceleration", self.acceleration)):
            if not 0 < value < inf:
                raise ValueError(f"`{name}` must be positive, found {value:g}")


def fourier(
    low: float | Sequence[float],
    high: float | Sequence[float],
    speed: float | Sequence[float],
    acceleration: float | Sequence[float],
    base_frequency: float,
    duration: float,
    harmonics: int = 5,
    centre: float | Sequence[float] | None = None,
    sine: Sequence[Sequence[float]] | None = None,
    cosine: Sequence[Sequence[float]] | None = None,
    seed: Seed = 0,
) -> Excitations | FourierSeries:
    """Return Fourier series for as many joints as the longest list has values; one where there is none.

    Random coefficients are projected so that the joints begin and end at rest, and scaled so that each joint
    reaches the first of its limits.

    Args:
        low: Lowest position, one number or one per joint, in the unit of the joint.
        high: Highest position.
        speed: Highest speed, unit/s.
        acceleration: Highest acceleration, unit/s².
        base_frequency: Frequency of the first harmonic, Hz.
        duration: Duration, s: a whole number of periods.
        harmonics: Number of harmonics.
        centre: Position at rest; the middle between ``low`` and ``high`` by default.
        sine: Coefficients a_k, a list for each joint, that replace the random ones.
        cosine: Coefficients b_k, likewise.
        seed: Seed of the random coefficients.

    Raises:
        ValueError: Coefficients break a limit or do not begin at rest, or an argument is out of range.
    """
    _check_periods(base_frequency, duration)
    limits = _limits(low, high, speed, acceleration, centre)
    if (sine is None) != (cosine is None):
        raise ValueError("give both `sine` and `cosine`, a list for each joint, or neither")
    if sine is not None and cosine is not None:
        joints = _from_coefficients(limits, base_frequency, sine, cosine)
    else:
        joints = _draw_series(limits, base_frequency, harmonics, seed)
    return joints[0] if len(joints) == 1 else Excitations(joints)


def evaluate_motion(
    joints: Excitations | FourierSeries, t: Sequence[float] | FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate Fourier series and their derivatives.

    Args:
        joints: The series of one joint or of several.
        t: Times (n,), s.

    Returns:
        Positions, velocities and accelerations, each (n, joints).

    Raises:
        TypeError: An excitation is no Fourier series.
    """
    times = np.asarray(t, dtype=np.float64)
    parts = joints.columns if isinstance(joints, Excitations) else (joints,)
    columns = []
    for part in parts:
        if not isinstance(part, FourierSeries):
            raise TypeError(f"expected Fourier series, found {type(part).__name__}")
        q, qd, qdd = _evaluate(np.array(part.sine), np.array(part.cosine), part.base_frequency, times)
        columns.append((part.centre + q, qd, qdd))
    q, qd, qdd = (np.column_stack(quantity) for quantity in zip(*columns, strict=True))
    return q, qd, qdd


def _evaluate(
    sine: FloatArray, cosine: FloatArray, base_frequency: float, t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position without the centre, velocity and acceleration, each (n,)."""
    omegas = 2 * pi * base_frequency * np.arange(1, len(sine) + 1)
    s, c = np.sin(np.outer(t, omegas)), np.cos(np.outer(t, omegas))
    position = s @ (sine / omegas) - c @ (cosine / omegas)
    return position, c @ sine + s @ cosine, c @ (cosine * omegas) - s @ (sine * omegas)


def _bounds(
    sine: FloatArray, cosine: FloatArray, base_frequency: float, *, points_per_harmonic: int = 64
) -> tuple[float, float, float, float]:
    """Bound lowest and highest excursion, speed and acceleration at all times, from values on a grid.

    A trigonometric polynomial of degree K that stays within M on N even points of its period stays
    within M/cos(πK/N) everywhere (Ehlich and Zeller 1964). The same holds for excursions about their mean.
    """
    points = points_per_harmonic * len(sine)
    t = np.arange(points) / (points * base_frequency)
    margin = 1 / cos(pi * len(sine) / points)
    q, qd, qdd = _evaluate(sine, cosine, base_frequency, t)
    middle, reach = (q.max() + q.min()) / 2, margin * (q.max() - q.min()) / 2
    max_speed, max_acceleration = margin * np.abs(qd).max(), margin * np.abs(qdd).max()
    return float(middle - reach), float(middle + reach), float(max_speed), float(max_acceleration)


def _draw_series(
    limits: Sequence[JointLimits], base_frequency: float, harmonics: int, seed: Seed
) -> tuple[FourierSeries, ...]:
    if harmonics < MIN_HARMONICS:
        raise ValueError(f"`harmonics` must be {MIN_HARMONICS} at least, found {harmonics}")
    rng, k = np.random.default_rng(seed), np.arange(1, harmonics + 1)
    joints = []
    for limit in limits:
        sine = _project_out(rng.standard_normal(harmonics), np.ones((1, harmonics)))
        cosine = _project_out(rng.standard_normal(harmonics), np.stack([k, 1 / k]))
        lowest, highest, max_speed, max_acceleration = _bounds(sine, cosine, base_frequency)
        scale = ROUNDING * min(
            (limit.high - limit.centre) / highest,
            (limit.low - limit.centre) / lowest,
            limit.speed / max_speed,
            limit.acceleration / max_acceleration,
        )
        joints.append(_series(limit.centre, base_frequency, scale * sine, scale * cosine))
    return tuple(joints)


def _project_out(values: FloatArray, conditions: FloatArray) -> FloatArray:
    """Project ``values`` onto the null space of ``conditions``."""
    basis = np.linalg.qr(conditions.T)[0]
    return values - basis @ (basis.T @ values)


def _series(centre: float, base_frequency: float, sine: FloatArray, cosine: FloatArray) -> FourierSeries:
    return FourierSeries(centre, base_frequency, tuple(sine.tolist()), tuple(cosine.tolist()))


def _from_coefficients(
    limits: Sequence[JointLimits],
    base_frequency: float,
    sine: Sequence[Sequence[float]],
    cosine: Sequence[Sequence[float]],
) -> tuple[FourierSeries, ...]:
    if not len(sine) == len(cosine) == len(limits):
        counts = f"{len(sine)} and {len(cosine)}"
        raise ValueError(f"`sine` and `cosine` need a list for each of {len(limits)} joints, found {counts}")
    joints = []
    for joint, (limit, a, b) in enumerate(zip(limits, sine, cosine, strict=True)):
        if len(a) != len(b) or not a:
            raise ValueError(
                f"joint {joint}: `sine` and `cosine` need as many values, found {len(a)} and {len(b)}"
            )
        series = _series(limit.centre, base_frequency, np.array(a, float), np.array(b, float))
        _check_limits(joint, limit, series)
        joints.append(series)
    return tuple(joints)


def _check_limits(joint: int, limit: JointLimits, series: FourierSeries) -> None:
    """Raise ValueError for a series that breaks a limit or does not begin at rest."""
    a, b = np.array(series.sine), np.array(series.cosine)
    lowest, highest, max_speed, max_acceleration = _bounds(a, b, series.base_frequency)
    reached = (
        ("position", limit.centre + lowest, limit.low, limit.high),
        ("position", limit.centre + highest, limit.low, limit.high),
        ("speed", max_speed, 0.0, limit.speed),
        ("acceleration", max_acceleration, 0.0, limit.acceleration),
    )
    for name, value, low, high in reached:
        if not low <= value <= high:
            raise ValueError(f"joint {joint}: {name} reaches {value:.4g}, its limits are {low:g} to {high:g}")
    k = np.arange(1, len(a) + 1)
    at_rest = (
        ("velocity", abs(a.sum()), max_speed),
        ("acceleration", abs(float(k @ b)), float(k @ np.abs(b))),
    )
    for name, value, scale in at_rest:
        if value > REST_TOLERANCE * scale:
            raise ValueError(
                f"joint {joint}: its {name} is not zero where the period begins: expected "
                "Σ sine = 0 and Σ k·cosine = 0"
            )


def _check_periods(base_frequency: float, duration: float) -> None:
    if not 0 < base_frequency < inf:
        raise ValueError(f"`base_frequency` must be a positive number of Hz, found {base_frequency:g}")
    periods = duration * base_frequency
    whole_periods = round(periods) if isfinite(periods) else 0
    if not (whole_periods >= 1 and abs(periods - whole_periods) <= REST_TOLERANCE * periods):
        raise ValueError(
            f"`duration` must be whole periods of {1 / base_frequency:g} s, for the joints to be at rest "
            f"at the end; found {duration:g} s"
        )


def _limits(
    low: float | Sequence[float],
    high: float | Sequence[float],
    speed: float | Sequence[float],
    acceleration: float | Sequence[float],
    centre: float | Sequence[float] | None,
) -> tuple[JointLimits, ...]:
    given = {"low": low, "high": high, "speed": speed, "acceleration": acceleration}
    if centre is not None:
        given["centre"] = centre
    rows = {name: [v] if isinstance(v, (int, float)) else list(v) for name, v in given.items()}
    width = max(len(row) for row in rows.values())
    for name, row in rows.items():
        if len(row) not in (1, width):
            raise ValueError(f"`{name}` has {len(row)} values for {width} joints; give one, or one each")
    full = {name: row * width if len(row) == 1 else row for name, row in rows.items()}
    middle = [(a + b) / 2 for a, b in zip(full["low"], full["high"], strict=True)]
    full.setdefault("centre", middle)
    return tuple(JointLimits(**{name: row[j] for name, row in full.items()}) for j in range(width))
