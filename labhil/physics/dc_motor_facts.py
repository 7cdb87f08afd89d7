"""What two balances say of a DC motor's recording before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

import numpy as np

from labhil.physics.facts import CERTAIN, TIME, Fact, integral, rate_fact, rate_of_change_fact, slopes
from labhil.physics.model import Record
from labhil.signals import FloatArray

WITHIN = 4.0
"""Factor to which quick regressions know a constant: a lag of the winding, friction and noise bias them."""


def facts(record: Record, known: Mapping[str, float]) -> list[Fact]:
    """Signs of the answers, and constants that two balances, or a balance and the rig file, both know.

    In SI units the constant that gives a torque per current gives a voltage per speed, too. With the inertia
    known both are measured, and their ratio tells units of speed, current, voltage and time apart.
    """
    t, u = record.t, record.inputs[:, 0]
    channels = dict(zip(record.output_names, record.outputs.T, strict=True))
    figures = [rate_fact(record, 0.5, 1e6)]
    speed, current = channels.get("speed"), channels.get("current")
    if speed is not None and "angle" in record.auxiliary:
        figures += rate_of_change_fact(t, "angle", record.auxiliary["angle"], "speed", speed)
    if speed is not None:
        push = [integral(t, u, held=True), integral(t, speed), integral(t, np.sign(speed))]
        answer, sure = slopes(speed, push, t, 0)
        figures += _positive(
            "the answer of speed to voltage", answer[0], sure[0], {"speed": 1, "voltage": -1}
        )
    if speed is not None and current is not None:
        figures += _balances(t, u, speed, current, known)
    return figures


def _balances(
    t: FloatArray, u: FloatArray, speed: FloatArray, current: FloatArray, known: Mapping[str, float]
) -> list[Fact]:
    """∫U = R·∫i + L·i + K·∫ω and ω = (K/J)·∫i − …, each up to a constant."""
    charge, turned = integral(t, current), integral(t, speed)
    electrical, sure = slopes(integral(t, u, held=True), [turned, charge, current], t, 0)
    torque, certain = slopes(speed, [charge, turned, integral(t, np.sign(speed))], t, 0)
    by_speed, by_current = {"voltage": 1, "speed": -1}, {"voltage": 1, "current": -1}
    figures = _positive("the voltage per speed", electrical[0], sure[0], by_speed)
    figures += _positive("the voltage per current", electrical[1], sure[1], by_current)
    figures += _positive("the answer of speed to current", torque[0], certain[0], {"speed": 1, "current": -1})
    emf = electrical[0] if abs(sure[0]) > CERTAIN else None
    if emf is not None and "torque_constant" in known:
        ratio = emf / known["torque_constant"]
        figures.append(_ratio("the voltage per speed over torque_constant", ratio, by_speed))
    if abs(sure[1]) > CERTAIN and "resistance" in known:
        figures.append(
            _ratio("the voltage per current over resistance", electrical[1] / known["resistance"], by_current)
        )
    if emf and abs(certain[0]) > CERTAIN and "inertia" in known:
        ratio = torque[0] * known["inertia"] / emf
        powers = {"speed": 2, "current": -1, "voltage": -1, TIME: -1}
        figures.append(_ratio("the torque per current over the voltage per speed", ratio, powers))
    return figures


def _positive(what: str, value: float, certainty: float, powers: Mapping[str, int]) -> list[Fact]:
    if abs(certainty) <= CERTAIN:
        return []
    return [Fact(what, float(value), "", 0.0, inf, powers, "a motor runs the way it is driven", dynamic=True)]


def _ratio(what: str, value: float, powers: Mapping[str, int]) -> Fact:
    why = "they are the same in SI units"
    return Fact(what, float(value), "", 1.0 / WITHIN, WITHIN, powers, why, 1.0, dynamic=True)
