"""The servo: how the joints follow a plan, and the plan between its rows.

The servo feeds position and velocity forward, not acceleration: its error e = q − q_plan obeys
ë = −ω²·e − 2ω·ė − q̈_plan. With q̈_plan linear between two samples the solution is exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.plants.arm.links import JOINTS
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Motion:
    """Angles rad, velocities rad/s and accelerations rad/s² of the six joints at ``t`` s; (n, 6) and (n,)."""

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray

    @classmethod
    def empty(cls, t: FloatArray) -> Motion:
        """Allocate a motion at the times ``t``."""
        shape = (len(t), JOINTS)
        return cls(t, np.empty(shape), np.empty(shape), np.empty(shape))

    def at(self, t: FloatArray) -> Motion:
        """Return the motion at other times (m,): cubics between the rows, constant acceleration outside."""
        if np.array_equal(t, self.t):
            return self
        row = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        after = np.minimum(row + 1, len(self.t) - 1)
        is_outside = ((t < self.t[0]) | (after == row))[:, None]
        span = np.where(after == row, 1.0, self.t[after] - self.t[row])[:, None]
        s = (t - self.t[row])[:, None]
        q, qd, qdd = self.q[row], self.qd[row], self.qdd[row]
        return Motion(
            t,
            np.where(
                is_outside, q + s * (qd + 0.5 * s * qdd), cubic(q, qd, self.q[after], self.qd[after], s, span)
            ),
            np.where(is_outside, qd + s * qdd, cubic(qd, qdd, self.qd[after], self.qdd[after], s, span)),
            np.where(is_outside, qdd, qdd + (self.qdd[after] - qdd) * s / span),
        )


def cubic(
    y0: FloatArray, slope0: FloatArray, y1: FloatArray, slope1: FloatArray, s: FloatArray, span: FloatArray
) -> FloatArray:
    """Return the cubic with values and slopes at both ends of ``span``, at ``s`` from its beginning."""
    u = s / span
    rise = u * u * (3.0 - 2.0 * u)
    bend = u * (1.0 - u)
    return np.asarray(y0 + rise * (y1 - y0) + span * bend * ((1.0 - u) * slope0 - u * slope1))


def cubic_slope(
    y0: FloatArray, slope0: FloatArray, y1: FloatArray, slope1: FloatArray, s: FloatArray, span: FloatArray
) -> FloatArray:
    """Return the slope of the cubic of :func:`cubic`."""
    u = s / span
    ends = (1.0 - u) * (1.0 - 3.0 * u) * slope0 + u * (3.0 * u - 2.0) * slope1
    return np.asarray(6.0 * u * (1.0 - u) * (y1 - y0) / span + ends)


class ServoState(NamedTuple):
    """State of the servo, (6,) each: error rad, rate of the error, last planned acceleration."""

    error: FloatArray
    rate: FloatArray
    planned: FloatArray

    @classmethod
    def steady(cls, qdd: FloatArray, bandwidth: float) -> ServoState:
        """Return the steady state under a constant acceleration (6,)."""
        return cls(-qdd / bandwidth**2, np.zeros(JOINTS), qdd.copy())


def track(plan: Motion, h: FloatArray, bandwidth: float, servo: ServoState) -> Motion:
    """Return how the joints move along a plan, row i ``h[i]`` s after the one before; ``servo`` moves on.

    ``bandwidth`` is the servo's ω, rad/s.
    """
    moved = Motion.empty(plan.t)
    follow_plan(plan.q, plan.qd, plan.qdd, h, bandwidth, servo, moved.q, moved.qd, moved.qdd)
    return moved


@compiled
def follow_plan(
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    h: FloatArray,
    w: float,
    servo: ServoState,
    out_q: FloatArray,
    out_qd: FloatArray,
    out_qdd: FloatArray,
) -> None:
    """Advance the servo's error through all rows, in place; see ``track``."""
    for i in range(h.size):
        decay = math.exp(-w * h[i])
        for j in range(q.shape[1]):
            before, now = servo.planned[j], qdd[i, j]
            if h[i] > 0.0:
                slope = (now - before) / h[i]
                shift = 2.0 * slope / w**3
                free = servo.error[j] + before / w**2 - shift
                kick = servo.rate[j] + slope / w**2 + w * free
                servo.error[j] = -now / w**2 + shift + (free + kick * h[i]) * decay
                servo.rate[j] = -slope / w**2 + (kick - w * (free + kick * h[i])) * decay
            servo.planned[j] = now
            out_q[i, j] = q[i, j] + servo.error[j]
            out_qd[i, j] = qd[i, j] + servo.rate[j]
            out_qdd[i, j] = -w * (w * servo.error[j] + 2.0 * servo.rate[j])
