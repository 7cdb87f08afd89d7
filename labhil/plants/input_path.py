"""What happens to the servo angle on its way to the linkage, one moment after the other.

Order: time delay, backlash, dead zone, saturation, rate limit, lag. Between two moments every
signal is a straight line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.signals import FloatArray

HISTORY = 512
"""How many past samples of the angle are remembered for the delay."""
PLAY, TURNED, UNLAGGED, LAGGED = range(4)
PATH_SIZE = 4


class InputPath(NamedTuple):
    """Strengths of all effects on the way in (SI); neutral where an effect is absent."""

    delay: float
    gap: float
    left: float
    right: float
    limit: float
    rate: float
    lag: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> InputPath:
        """Pick them out of a plant's parameters."""
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
def read_delayed(history: FloatArray, newest: int, behind: float) -> float:
    """Return the angle ``behind`` samples before the one with number ``newest``."""
    samples = math.floor(behind)
    part = behind - samples
    after = float(history[(newest - samples) % HISTORY])
    if part == 0.0:
        return after
    return after + part * (float(history[(newest - samples - 1) % HISTORY]) - after)


@compiled
def without_dead_zone(angle: float, left: float, right: float) -> float:
    """Return what is left of an angle (rad) outside −left … right (eq. 4.18 of the reference text)."""
    if angle >= right:
        return angle - right
    if angle <= -left:
        return angle + left
    return 0.0


@compiled
def first_order(y: float, before: float, now: float, h: float, time_constant: float) -> float:
    """Return the lagged signal after h (s) in which its input went straight from ``before`` to ``now``."""
    if time_constant <= 0.0:
        return now
    trail = (now - before) / h * time_constant
    return now - trail + (y - before + trail) * math.exp(-h / time_constant)


@compiled
def follow(path: FloatArray, angle: float, h: float, p: InputPath) -> float:
    """Go one moment of h (s) on to ``angle`` (rad, already delayed); return the angle at the linkage."""
    path[PLAY] = min(max(path[PLAY], angle - 0.5 * p.gap), angle + 0.5 * p.gap)
    wanted = without_dead_zone(path[PLAY], p.left, p.right)
    wanted = min(max(wanted, -p.limit), p.limit)
    path[TURNED] = min(max(wanted, path[TURNED] - p.rate * h), path[TURNED] + p.rate * h)
    path[LAGGED] = first_order(path[LAGGED], path[UNLAGGED], path[TURNED], h, p.lag)
    path[UNLAGGED] = path[TURNED]
    return float(path[LAGGED])


def settle(angle: float, p: InputPath) -> FloatArray:
    """Return the path's memory after a long time at ``angle`` (rad), in the middle of the play."""
    wanted = min(max(without_dead_zone(angle, p.left, p.right), -p.limit), p.limit)
    path = np.full(PATH_SIZE, wanted)
    path[PLAY] = angle
    return path
