"""Plausibility figures of a DC motor's recording (see ``physics.facts``)."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

import numpy as np

from labhil.physics.facts import (
    MIN_T_RATIO,
    TIME,
    Fact,
    derivative_fact,
    regress_stretches,
    running_integral,
    sampling_rate_fact,
)
from labhil.physics.record import Record
from labhil.signals import FloatArray

RATIO_FACTOR = 4.0
"""Factor within which the regressions give a constant: lag of the winding, friction and noise bias them."""


def facts(record: Record, known: Mapping[str, float]) -> list[Fact]:
    """Compute the facts: signs of the responses, and constants that are known twice.

    In SI units torque per current equals voltage per speed. With a known inertia both are measured, and their
    ratio separates the units of speed, current, voltage and time.

    Args:
        record: The recording.
        known: Numbers that the rig file states.

    Returns:
        The facts.
    """
    t, u = record.t, record.inputs[:, 0]
    channels = dict(zip(record.output_names, record.outputs.T, strict=True))
    figures = [sampling_rate_fact(record, 0.5, 1e6)]
    speed, current = channels.get("speed"), channels.get("current")
    if speed is not None and "angle" in record.auxiliary:
        figures += derivative_fact(t, "angle", record.auxiliary["angle"], "speed", speed)
    if speed is not None:
        push = [
            running_integral(t, u, held=True),
            running_integral(t, speed),
            running_integral(t, np.sign(speed)),
        ]
        answer, sure = regress_stretches(speed, push, t, 0)
        figures += _positive(
            "the answer of speed to voltage", answer[0], sure[0], {"speed": 1, "voltage": -1}
        )
    if speed is not None and current is not None:
        figures += _balances(t, u, speed, current, known)
    return figures


def _balances(
    t: FloatArray, u: FloatArray, speed: FloatArray, current: FloatArray, known: Mapping[str, float]
) -> list[Fact]:
    """Facts of ∫U = R·∫i + L·i + K·∫ω and ω = (K/J)·∫i − …, each up to a constant."""
    charge, turned = running_integral(t, current), running_integral(t, speed)
    electrical, sure = regress_stretches(running_integral(t, u, held=True), [turned, charge, current], t, 0)
    torque, certain = regress_stretches(speed, [charge, turned, running_integral(t, np.sign(speed))], t, 0)
    by_speed, by_current = {"voltage": 1, "speed": -1}, {"voltage": 1, "current": -1}
    figures = _positive("the voltage per speed", electrical[0], sure[0], by_speed)
    figures += _positive("the voltage per current", electrical[1], sure[1], by_current)
    figures += _positive("the answer of speed to current", torque[0], certain[0], {"speed": 1, "current": -1})
    emf = electrical[0] if abs(sure[0]) > MIN_T_RATIO else None
    if emf is not None and "torque_constant" in known:
        ratio = emf / known["torque_constant"]
        figures.append(_ratio("the voltage per speed over torque_constant", ratio, by_speed))
    if abs(sure[1]) > MIN_T_RATIO and "resistance" in known:
        figures.append(
            _ratio("the voltage per current over resistance", electrical[1] / known["resistance"], by_current)
        )
    if emf and abs(certain[0]) > MIN_T_RATIO and "inertia" in known:
        ratio = torque[0] * known["inertia"] / emf
        powers = {"speed": 2, "current": -1, "voltage": -1, TIME: -1}
        figures.append(_ratio("the torque per current over the voltage per speed", ratio, powers))
    return figures


def _positive(what: str, value: float, certainty: float, powers: Mapping[str, int]) -> list[Fact]:
    """The fact that a slope with a sufficient t ratio is positive."""
    if abs(certainty) <= MIN_T_RATIO:
        return []
    return [
        Fact(
            what,
            float(value),
            "",
            0.0,
            inf,
            powers,
            "a motor turns in the direction in which it is driven",
            dynamic=True,
        )
    ]


def _ratio(what: str, value: float, powers: Mapping[str, int]) -> Fact:
    """The fact that a ratio of two estimates of a constant is about 1."""
    why = "they are the same in SI units"
    return Fact(what, float(value), "", 1.0 / RATIO_FACTOR, RATIO_FACTOR, powers, why, 1.0, dynamic=True)
