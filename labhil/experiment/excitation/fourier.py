"""Trajectories of an arm's joints as Fourier series that begin and end at rest.

Every joint moves on q(t) = ``centre`` + Σ_k a_k/(kω)·sin(kωt) − b_k/(kω)·cos(kωt), ω = 2π times the base
frequency (Swevers et al. 1997: periodic, band-limited, velocities and accelerations known exactly). Here
Σ a_k = 0, Σ k·b_k = 0 and Σ b_k/k = 0, so that velocity and acceleration vanish and the joint stands at
``centre`` whenever a period begins: a robot can be brought there before, and stops there after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, isfinite, pi, sin

import numpy as np

from labhil.experiment.excitation.function import Excitations, Seed
from labhil.signals import FloatArray

FEWEST_HARMONICS = 3
"""Fewer leave no cosine that meets both of its conditions."""
POINTS_PER_HARMONIC = 64
WHOLE = 1e-6
"""How near to a whole number of periods a duration must be."""
ROUNDING = 1 - 1e-9


@dataclass(frozen=True, slots=True)
class FourierSeries:
    """One joint's trajectory; ``sine`` are the a_k and ``cosine`` the b_k in unit/s, k = 1, 2, …"""

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
    """What one joint may do: ``low`` to ``high`` around ``centre``, ``speed``, ``acceleration``; SI units."""

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

    Coefficients are drawn with ``seed``, brought to rest at the ends, and scaled so that each joint
    reaches the first of its limits: positions ``low`` to ``high`` (unit), ``speed`` (unit/s),
    ``acceleration`` (unit/s²). ``sine`` and ``cosine``, a list for each joint, are taken as they are,
    and refused when they break a limit or do not begin at rest. ``duration`` (s) is whole periods of
    ``base_frequency`` (Hz). Raises ValueError.
    """
    _check_periods(base_frequency, duration)
    limits = _limits(low, high, speed, acceleration, centre)
    if (sine is None) != (cosine is None):
        raise ValueError("give both `sine` and `cosine`, a list for each joint, or neither")
    if sine is not None and cosine is not None:
        joints = _from_coefficients(limits, base_frequency, sine, cosine)
    else:
        joints = _draw(limits, base_frequency, harmonics, seed)
    return joints[0] if len(joints) == 1 else Excitations(joints)


def evaluate_motion(
    joints: Excitations | FourierSeries, t: Sequence[float] | FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions, velocities and accelerations (n, joints) at the times ``t`` (n,) in s.

    TypeError for an excitation that is no Fourier series.
    """
    times = np.asarray(t, dtype=np.float64)
    parts = joints.columns if isinstance(joints, Excitations) else (joints,)
    columns = []
    for part in parts:
        if not isinstance(part, FourierSeries):
            raise TypeError(f"expected Fourier series, found {type(part).__name__}")
        q, qd, qdd = _motion(np.array(part.sine), np.array(part.cosine), part.base_frequency, times)
        columns.append((part.centre + q, qd, qdd))
    q, qd, qdd = (np.column_stack(kind) for kind in zip(*columns, strict=True))
    return q, qd, qdd


def _motion(
    sine: FloatArray, cosine: FloatArray, base_frequency: float, t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    rates = 2 * pi * base_frequency * np.arange(1, len(sine) + 1)
    s, c = np.sin(np.outer(t, rates)), np.cos(np.outer(t, rates))
    position = s @ (sine / rates) - c @ (cosine / rates)
    return position, c @ sine + s @ cosine, c @ (cosine * rates) - s @ (sine * rates)


def _extremes(
    sine: FloatArray, cosine: FloatArray, base_frequency: float
) -> tuple[float, float, float, float]:
    """Bounds on lowest and highest excursion, speed and acceleration, over all time and not a grid alone.

    A trigonometric polynomial of degree K that stays within M on N even points of its period stays
    within M/cos(πK/N) everywhere (Ehlich and Zeller 1964); excursions to the two sides are separated
    by their mean, of which the same is true.
    """
    points = POINTS_PER_HARMONIC * len(sine)
    t = np.arange(points) / (points * base_frequency)
    beyond = 1 / cos(pi * len(sine) / points)
    q, qd, qdd = _motion(sine, cosine, base_frequency, t)
    middle, reach = (q.max() + q.min()) / 2, beyond * (q.max() - q.min()) / 2
    fastest, hardest = beyond * np.abs(qd).max(), beyond * np.abs(qdd).max()
    return float(middle - reach), float(middle + reach), float(fastest), float(hardest)


def _draw(
    limits: Sequence[JointLimits], base_frequency: float, harmonics: int, seed: Seed
) -> tuple[FourierSeries, ...]:
    if harmonics < FEWEST_HARMONICS:
        raise ValueError(f"`harmonics` must be {FEWEST_HARMONICS} at least, found {harmonics}")
    draw, k = np.random.default_rng(seed), np.arange(1, harmonics + 1)
    joints = []
    for limit in limits:
        sine = _project_out(draw.standard_normal(harmonics), np.ones((1, harmonics)))
        cosine = _project_out(draw.standard_normal(harmonics), np.stack([k, 1 / k]))
        down, up, fastest, hardest = _extremes(sine, cosine, base_frequency)
        scale = ROUNDING * min(
            (limit.high - limit.centre) / up,
            (limit.low - limit.centre) / down,
            limit.speed / fastest,
            limit.acceleration / hardest,
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
        _refuse_beyond(joint, limit, series)
        joints.append(series)
    return tuple(joints)


def _refuse_beyond(joint: int, limit: JointLimits, series: FourierSeries) -> None:
    a, b = np.array(series.sine), np.array(series.cosine)
    down, up, fastest, hardest = _extremes(a, b, series.base_frequency)
    reach = (
        ("position", limit.centre + down, limit.low, limit.high),
        ("position", limit.centre + up, limit.low, limit.high),
        ("speed", fastest, 0.0, limit.speed),
        ("acceleration", hardest, 0.0, limit.acceleration),
    )
    for name, value, lowest, highest in reach:
        if not lowest <= value <= highest:
            raise ValueError(
                f"joint {joint}: {name} reaches {value:.4g}, its limits are {lowest:g} to {highest:g}"
            )
    k = np.arange(1, len(a) + 1)
    sums = (("velocity", abs(a.sum()), fastest), ("acceleration", abs(float(k @ b)), float(k @ np.abs(b))))
    for name, value, scale in sums:
        if value > WHOLE * scale:
            raise ValueError(
                f"joint {joint}: its {name} is not zero where the period begins: expected "
                "Σ sine = 0 and Σ k·cosine = 0"
            )


def _check_periods(base_frequency: float, duration: float) -> None:
    if not 0 < base_frequency < inf:
        raise ValueError(f"`base_frequency` must be a positive number of Hz, found {base_frequency:g}")
    periods = duration * base_frequency
    if not (isfinite(periods) and round(periods) >= 1 and abs(periods - round(periods)) <= WHOLE * periods):
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
    stated = {"low": low, "high": high, "speed": speed, "acceleration": acceleration}
    if centre is not None:
        stated["centre"] = centre
    rows = {name: [v] if isinstance(v, (int, float)) else list(v) for name, v in stated.items()}
    width = max(len(row) for row in rows.values())
    for name, row in rows.items():
        if len(row) not in (1, width):
            raise ValueError(f"`{name}` has {len(row)} values for {width} joints; give one, or one each")
    full = {name: row * width if len(row) == 1 else row for name, row in rows.items()}
    middle = [(a + b) / 2 for a, b in zip(full["low"], full["high"], strict=True)]
    full.setdefault("centre", middle)
    return tuple(JointLimits(**{name: row[j] for name, row in full.items()}) for j in range(width))
