"""Plausibility figures of an arm's recording (see ``physics.facts``)."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import numpy as np

from labhil.physics.facts import Fact, amplitude_fact, derivative_fact, sampling_rate_fact
from labhil.physics.record import Record
from labhil.signals import FloatArray


def facts(
    record: Record,
    known: Mapping[str, float],
    *,
    max_angle: float = 2.2 * pi,
    max_velocity: float = 2.2 * pi,
    max_current: float = 100.0,
) -> list[Fact]:
    """Compute the facts: bounds on angles, velocities, currents and sampling rate; velocity is ∂angle/∂t.

    Args:
        record: The recording.
        known: Numbers that the rig file states.
        max_angle: rad; joints of UR arms reach ±360°. The last joint is not bounded: on some arms it turns
            without end.
        max_velocity: rad/s; the wrists of the fastest arms turn once a second.
        max_current: A; several times the peak current of a joint's motor.

    Returns:
        The facts.
    """
    q, qd = _joints(record, "actual_q"), _joints(record, "actual_qd")
    return [
        sampling_rate_fact(record, 1.0, 1e4),
        amplitude_fact("actual_q", "rad", q[:, :-1], max_angle, 1.5, "a joint reaches one turn each way"),
        amplitude_fact("actual_qd", "rad/s", qd, max_velocity, 1.0, "a joint turns once a second at most"),
        amplitude_fact("actual_current", "A", record.outputs, max_current, 5.0, "a joint's motor takes less"),
        *derivative_fact(record.t, "actual_q", q, "actual_qd", qd),
    ]


def _joints(record: Record, name: str) -> FloatArray:
    """Input columns of a signal of all joints, (n, joints)."""
    names = [f"{name}_{joint}" for joint in range(record.outputs.shape[1])]
    return np.column_stack([record.inputs[:, record.input_names.index(column)] for column in names])
