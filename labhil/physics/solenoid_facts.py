"""What a solenoid's stroke and pull say of its recording before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

import numpy as np

from labhil.physics.facts import Fact, rate_fact, size_fact
from labhil.physics.model import Record

LONGEST_STROKE = 0.3
"""m; of a bench: longer ones are built, but their forces are not of a plunger between two stops."""

TYPICAL_STROKE = 5e-3
"""m."""

STRONGEST = 200.0
"""A, through a coil on a bench."""

FOLLOWS = 0.5
"""Correlation of position and squared current from which on the one is seen to follow the other."""


def facts(record: Record, known: Mapping[str, float]) -> list[Fact]:
    """Bounds on stroke, current and rate; the plunger is pulled away from its rest stop."""
    i, x = record.inputs[:, 0], record.outputs[:, 0]
    stops = [abs(known[name]) for name in ("stop_low", "stop_high") if name in known]
    high = 1.5 * max(stops) if len(stops) == 2 else LONGEST_STROKE
    why = "the stops of the rig file" if len(stops) == 2 else "a plunger's stroke is shorter"
    figures = [
        rate_fact(record, 20.0, 1e6, 1000.0),
        size_fact("plunger_position", "m", x, high, TYPICAL_STROKE, why),
        size_fact("coil_current", "A", i, STRONGEST, 1.0, "a bench's coil takes less"),
    ]
    if np.ptp(i) > 0.0 and np.ptp(x) > 0.0:
        alike = float(np.corrcoef(i**2, x)[0, 1])
        if abs(alike) > FOLLOWS:
            what = "the correlation of plunger_position with the square of coil_current"
            powers = {"plunger_position": 1}
            why = "current pulls the plunger away from its rest stop"
            # its sign alone scales: a correlation has no unit
            figures.append(Fact(what, float(np.sign(alike)), "", 0.0, inf, powers, why, dynamic=True))
    return figures
