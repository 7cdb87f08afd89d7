"""What the joints of an arm say of a recording before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import numpy as np

from labhil.physics.facts import Fact, rate_fact, rate_of_change_fact, size_fact
from labhil.physics.model import Record
from labhil.signals import FloatArray

FARTHEST = 2.2 * pi
"""rad; joints of the UR arms reach ± 360°, but the last of some turns without end."""

FASTEST = 2.2 * pi
"""rad/s; the wrists of the fastest turn once a second."""

STRONGEST = 100.0
"""A; several times what a joint's motor takes for a moment."""


def facts(record: Record, known: Mapping[str, float]) -> list[Fact]:
    """Bounds on angles, velocities, currents and rate; velocities are the derivatives of angles."""
    q, qd = _joints(record, "actual_q"), _joints(record, "actual_qd")
    return [
        rate_fact(record, 1.0, 1e4),
        size_fact("actual_q", "rad", q[:, :-1], FARTHEST, 1.5, "a joint reaches one turn each way"),
        size_fact("actual_qd", "rad/s", qd, FASTEST, 1.0, "a joint turns once a second at most"),
        size_fact("actual_current", "A", record.outputs, STRONGEST, 5.0, "a joint's motor takes less"),
        *rate_of_change_fact(record.t, "actual_q", q, "actual_qd", qd),
    ]


def _joints(record: Record, name: str) -> FloatArray:
    names = [f"{name}_{joint}" for joint in range(record.outputs.shape[1])]
    return np.column_stack([record.inputs[:, record.input_names.index(column)] for column in names])
