"""Plausibility figures of a solenoid's recording (see ``physics.facts``)."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

import numpy as np

from labhil.physics.facts import Fact, amplitude_fact, sampling_rate_fact
from labhil.physics.record import Record


def facts(
    record: Record,
    known: Mapping[str, float],
    *,
    max_stroke: float = 0.3,
    typical_stroke: float = 5e-3,
    max_current: float = 200.0,
    min_correlation: float = 0.5,
) -> list[Fact]:
    """Compute the facts: bounds on stroke, current and sampling rate, and the direction of the pull.

    Args:
        record: The recording.
        known: Numbers that the rig file states.
        max_stroke: Longest stroke of a bench, m; longer solenoids are no plunger between two stops.
        typical_stroke: m.
        max_current: Largest current through the coil of a bench, A.
        min_correlation: Least correlation of position and squared current that shows the direction.

    Returns:
        The facts.
    """
    i, x = record.inputs[:, 0], record.outputs[:, 0]
    stops = [abs(known[name]) for name in ("stop_low", "stop_high") if name in known]
    high = 1.5 * max(stops) if len(stops) == 2 else max_stroke
    why = "the stops of the rig file" if len(stops) == 2 else "a plunger's stroke is shorter"
    figures = [
        sampling_rate_fact(record, 20.0, 1e6, 1000.0),
        amplitude_fact("plunger_position", "m", x, high, typical_stroke, why),
        amplitude_fact("coil_current", "A", i, max_current, 1.0, "a bench's coil takes less"),
    ]
    if np.ptp(i) > 0.0 and np.ptp(x) > 0.0:
        correlation = float(np.corrcoef(i**2, x)[0, 1])
        if abs(correlation) > min_correlation:
            what = "the correlation of plunger_position with the square of coil_current"
            powers = {"plunger_position": 1}
            why = "current pulls the plunger away from its rest stop"
            # a correlation has no unit, so only its sign scales
            figures.append(Fact(what, float(np.sign(correlation)), "", 0.0, inf, powers, why, dynamic=True))
    return figures
