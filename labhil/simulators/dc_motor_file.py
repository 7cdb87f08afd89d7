"""Cogging of a ``dcmotor`` in a MuJoCo file, read and written.

MuJoCo adds the torque A·sin(N·θ + φ) at the motor's angle θ = g·x, with the gear g and the joint's position x
(MuJoCo documentation, "DC motor model"). The effect cogging_torque is the force −a·sin(k·x) − b·cos(k·x) at
the joint, so k = g·N, a = −g·A·cos φ and b = −g·A·sin φ.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import atan2, cos, hypot, sin
from typing import Any

from labhil.simulators.mechanism import COGGING_COLUMN, Field, is_dc_motor, read_value

SINE, COSINE, ORDER = (f"cogging_torque.{part}" for part in ("sine", "cosine", "order"))


def read_cogging(model: Any, actuator: int) -> dict[str, float]:
    """Return the parameters of the effect cogging_torque by name; empty for a motor without cogging."""
    if not is_dc_motor(model, actuator):
        return {}
    columns = slice(COGGING_COLUMN, COGGING_COLUMN + 3)
    amplitude, poles, phase = model.actuator_biasprm[actuator][columns].tolist()
    gear = read_value(model, Field.GEAR, actuator)
    if not amplitude or not poles or not gear:
        return {}
    order = gear * poles
    side = 1.0 if order > 0.0 else -1.0  # the effect has a positive order; the sine of a negative one turns
    return {
        SINE: -side * gear * amplitude * cos(phase),
        COSINE: -gear * amplitude * sin(phase),
        ORDER: abs(order),
    }


def cogging_numbers(
    values: Mapping[str, float], gear: float, *, tolerance: float = 1e-3
) -> tuple[float, float, float]:
    """Return amplitude (N·m), number of poles and phase (rad) of the motor's attribute ``cogging``.

    Args:
        values: parameters of the effect cogging_torque by name.
        gear: gear of the motor.
        tolerance: relative error up to which the number of poles is a whole one, as a motor has it.
    """
    sine, cosine = -values.get(SINE, 0.0) / gear, -values.get(COSINE, 0.0) / gear
    poles = values[ORDER] / gear
    if abs(poles - round(poles)) <= tolerance * abs(poles):
        poles = float(round(poles))
    if poles < 0.0:  # a gear that turns the motor the other way
        return hypot(sine, cosine), -poles, atan2(cosine, -sine)
    return hypot(sine, cosine), poles, atan2(cosine, sine)
