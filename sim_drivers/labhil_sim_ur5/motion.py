"""How the controller gets from where it is to where a program wants it: one object a motion.

A motion gives once a tick the next angles, velocities and accelerations that the controller plans.
It runs in its own time, which the controller lets pass slower when the speed slider is down.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple, Protocol

import numpy as np

from labhil.signals import FloatArray
from labhil_sim_ur5.kinematics import Geometry
from labhil_sim_ur5.poses import Pose, rotate, rotation_of, times, transpose, vector_of

SPEED_LIMIT = 3.3
"""rad/s of a joint, beyond which the safety system stops the arm (UR5: 180°/s, and what it tolerates)."""
JOINT_SPEED = 3.14159
"""rad/s that planned joint motions keep to."""
ACCELERATION_LIMIT = 40.0
"""rad/s² that joint motions keep to, as the client does."""
SLOWEST = 1e-4
"""rad/s or m/s, and their rates: slower wishes are taken as this."""
AT_REST = 1e-6
DIFFERENCE = 1e-4
"""s before and after a moment between which a Jacobian's change is taken."""


class MotionError(Exception):
    """A motion that the arm cannot follow: beyond its reach, through a singularity, too fast."""


class Plan(NamedTuple):
    """What the controller plans for one moment: rad, rad/s, rad/s², (6,) each."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray

    @classmethod
    def resting(cls, q: Sequence[float] | FloatArray) -> Plan:
        """At rest at the angles q."""
        return cls(np.array(q, dtype=np.float64), np.zeros(6), np.zeros(6))


class Motion(Protocol):
    """One motion; ``done`` when nothing of it is left."""

    done: bool

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then. MotionError when the arm cannot follow."""
        ...


class Trapezoid:
    """A way from 0 to ``length`` with steady acceleration up to a speed, and down again."""

    def __init__(self, length: float, speed: float, acceleration: float) -> None:
        self.length = length
        self._a = max(acceleration, SLOWEST)
        self._ramp = max(speed, SLOWEST) / self._a
        if length < self._a * self._ramp**2:
            self._ramp = sqrt(length / self._a)
        top = self._a * self._ramp
        self._cruise = (length - top * self._ramp) / top if top > 0.0 else 0.0
        self.duration = 2.0 * self._ramp + self._cruise

    def at(self, t: float) -> tuple[float, float, float]:
        """Return how far, how fast and how much faster at t (s)."""
        a, ramp = self._a, self._ramp
        if t >= self.duration:
            return self.length, 0.0, 0.0
        if t < ramp:
            return 0.5 * a * t * t, a * t, a
        left = self.duration - t
        if left < ramp:
            return self.length - 0.5 * a * left * left, a * left, -a
        return a * ramp * (t - 0.5 * ramp), a * ramp, 0.0


class JointMove:
    """``movej``: all joints begin and end together; speed and acceleration are those of the longest way."""

    def __init__(self, begin: FloatArray, end: FloatArray, speed: float, acceleration: float) -> None:
        self._begin, self._end = begin.copy(), np.array(end, dtype=np.float64)
        self._way = self._end - self._begin
        longest = float(np.abs(self._way).max())
        self._share = self._way / longest if longest > 0.0 else np.zeros(6)
        self._profile = Trapezoid(longest, min(speed, JOINT_SPEED), min(acceleration, ACCELERATION_LIMIT))
        self._t = 0.0
        self.done = False

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then."""
        self._t += h
        if self._t >= self._profile.duration:
            self.done = True
            return Plan.resting(self._end)
        s, sd, sdd = self._profile.at(self._t)
        return Plan(self._begin + self._share * s, self._share * sd, self._share * sdd)


class LineMove:
    """``movel``: the tool goes straight, its rotation about one axis; v and a in m/s, m/s².

    Where the tool turns by more rad than it moves by m, v and a are rad/s and rad/s² of the turn.
    """

    def __init__(
        self, arm: Geometry, tool: Pose, begin: FloatArray, end: Pose, speed: float, acceleration: float
    ) -> None:
        self._arm, self._tool = arm, tool
        first = arm.pose(begin, tool)
        self._from = first[:3]
        self._way = np.subtract(end[:3], first[:3])
        self._rotation = rotation_of(*first[3:])
        self._turn = np.array(vector_of(times(transpose(self._rotation), rotation_of(*end[3:]))))
        length = max(float(np.linalg.norm(self._way)), float(np.linalg.norm(self._turn)))
        self._profile = Trapezoid(length, speed, acceleration)
        spin = rotate(self._rotation, (self._turn[0], self._turn[1], self._turn[2]))
        self._twist = np.array([*self._way, *spin]) / length if length > 0.0 else np.zeros(6)
        self._q = begin.copy()
        self._t = 0.0
        self.done = False

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then; MotionError out of reach or through a singularity."""
        self._t += h
        s, sd, sdd = self._profile.at(self._t)
        share = s / self._profile.length if self._profile.length > 0.0 else 1.0
        place = self._from + share * self._way
        turn = vector_of(times(self._rotation, rotation_of(*(share * self._turn))))
        q = self._arm.inverse((*place, *turn), self._q, self._tool)
        if q is None:
            raise MotionError("the tool's way leads out of the arm's reach")
        now = np.array(q)
        if np.abs(now - self._q).max() > SPEED_LIMIT * h + 1e-3:
            raise MotionError("the tool's way leads through a singularity: a joint would have to jump")
        self.done = self._t >= self._profile.duration
        self._q = now
        if self.done:
            return Plan.resting(now)
        qd = joint_rates(self._arm, now, self._tool, self._twist * sd)
        return Plan(now, qd, joint_accelerations(self._arm, now, qd, self._tool, self._twist * sdd))


class Halt:
    """``stopj`` and ``stopl``: along the way the joints go, down to rest with a steady deceleration."""

    def __init__(self, now: Plan, time: float) -> None:
        self._q, self._first = now.q.copy(), now.qd.copy()
        self._time = time
        self._t = 0.0
        self.done = time <= 0.0

    @classmethod
    def of_joints(cls, now: Plan, deceleration: float) -> Halt:
        """The fastest joint loses ``deceleration`` rad/s²."""
        fastest = float(np.abs(now.qd).max())
        if fastest < AT_REST:
            return cls(now, 0.0)
        return cls(now, fastest / min(max(deceleration, SLOWEST), ACCELERATION_LIMIT))

    @classmethod
    def of_tool(cls, now: Plan, deceleration: float, arm: Geometry, tool: Pose) -> Halt:
        """The tool loses ``deceleration`` m/s² (or rad/s² of its turn, if that takes longer)."""
        if float(np.abs(now.qd).max()) < AT_REST:
            return cls(now, 0.0)
        twist = arm.jacobian(now.q, tool) @ now.qd
        speed = max(float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:])))
        shortest = float(np.abs(now.qd).max()) / ACCELERATION_LIMIT
        return cls(now, max(speed / max(deceleration, SLOWEST), shortest))

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then."""
        self._t = min(self._t + h, self._time)
        if self._t >= self._time:
            self.done = True
            return Plan.resting(self._q + 0.5 * self._time * self._first)
        left = 1.0 - self._t / self._time
        q = self._q + self._first * (self._t - 0.5 * self._t**2 / self._time)
        return Plan(q, self._first * left, -self._first / self._time)


def joint_rates(arm: Geometry, q: FloatArray, tool: Pose, twist: FloatArray) -> FloatArray:
    """Return the joint rates (6,) rad/s for a tool's velocity; MotionError near a singularity."""
    try:
        rates = np.linalg.solve(arm.jacobian(q, tool), twist)
    except np.linalg.LinAlgError as error:
        raise MotionError("the tool cannot move that way in this position: it is singular") from error
    if not np.abs(rates).max() <= SPEED_LIMIT:
        raise MotionError("a joint would have to turn too fast: near a singularity, or the tool too fast")
    return np.asarray(rates, dtype=np.float64)


def joint_accelerations(
    arm: Geometry, q: FloatArray, qd: FloatArray, tool: Pose, acceleration: FloatArray
) -> FloatArray:
    """Return the joints' accelerations (6,) rad/s² for a tool's, away from singularities.

    q̈ = J⁻¹·(a − J̇·q̇), with J̇·q̇ by a difference along the joints' way.
    """
    way = DIFFERENCE * qd
    turning = (arm.jacobian(q + way, tool) - arm.jacobian(q - way, tool)) @ qd / (2.0 * DIFFERENCE)
    return np.asarray(np.linalg.solve(arm.jacobian(q, tool), acceleration - turning), dtype=np.float64)


def towards(now: FloatArray, target: FloatArray, step: float) -> FloatArray:
    """Go from now to wanted along a straight line, the component with the longest way by at most ``step``."""
    missing = target - now
    longest = float(np.abs(missing).max())
    return target.copy() if longest <= step else now + missing * (step / longest)
