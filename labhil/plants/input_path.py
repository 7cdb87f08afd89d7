"""Input path of the ball and beam, from the servo angle to the linkage, substep by substep.

Order: time delay, backlash, dead zone, saturation, rate limit, lag. Within a substep
every signal is linear.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.signals import FloatArray

HISTORY = 512
"""Number of past samples in the buffer of the delay."""
PLAY, LIMITED, UNLAGGED, LAGGED = range(4)
PATH_SIZE = 4


class InputPath(NamedTuple):
    """Parameters of all effects of the input path, SI; neutral where an effect is absent."""

    delay: float
    gap: float
    left: float
    right: float
    limit: float
    rate: float
    lag: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> InputPath:
        """Take them from the parameters of a plant."""
        return cls(
            delay=values.get("time_delay.delay", 0.0),
            gap=values.get("backlash.gap", 0.0),
            left=values.get("dead_zone.left", 0.0),
            right=values.get("dead_zone.right", 0.0),
            limit=values.get("saturation.limit", math.inf),
            rate=values.get("rate_limit.rate", math.inf),
            lag=values.get("actuator_lag.time_constant", 0.0),
        )


NEUTRAL = InputPath.of({})


@compiled
def read_delayed(history: FloatArray, newest: int, samples_back: float) -> float:
    """Return the angle ``samples_back`` samples before the one with number ``newest``."""
    samples = math.floor(samples_back)
    part = samples_back - samples
    after = float(history[(newest - samples) % HISTORY])
    if part == 0.0:
        return after
    return after + part * (float(history[(newest - samples - 1) % HISTORY]) - after)


@compiled
def apply_dead_zone(angle: float, left: float, right: float) -> float:
    """Apply a dead zone −left … right to an angle (rad; eq. 4.18 of the reference text)."""
    if angle >= right:
        return angle - right
    if angle <= -left:
        return angle + left
    return 0.0


@compiled
def apply_lag(y: float, before: float, now: float, h: float, time_constant: float) -> float:
    """Return the lagged signal after h (s) in which its input went linearly from ``before`` to ``now``."""
    if time_constant <= 0.0:
        return now
    lag_error = (now - before) / h * time_constant
    return now - lag_error + (y - before + lag_error) * math.exp(-h / time_constant)


@compiled
def pass_through(path: FloatArray, angle: float, h: float, p: InputPath) -> float:
    """Advance by a substep of h (s) to the delayed ``angle`` (rad); return the angle at the linkage."""
    path[PLAY] = min(max(path[PLAY], angle - 0.5 * p.gap), angle + 0.5 * p.gap)
    target = apply_dead_zone(path[PLAY], p.left, p.right)
    target = min(max(target, -p.limit), p.limit)
    path[LIMITED] = min(max(target, path[LIMITED] - p.rate * h), path[LIMITED] + p.rate * h)
    path[LAGGED] = apply_lag(path[LAGGED], path[UNLAGGED], path[LIMITED], h, p.lag)
    path[UNLAGGED] = path[LIMITED]
    return float(path[LAGGED])


def settled_path(angle: float, p: InputPath) -> FloatArray:
    """Return the steady state of the path at ``angle`` (rad), in the middle of the backlash."""
    target = min(max(apply_dead_zone(angle, p.left, p.right), -p.limit), p.limit)
    path = np.full(PATH_SIZE, target)
    path[PLAY] = angle
    return path
