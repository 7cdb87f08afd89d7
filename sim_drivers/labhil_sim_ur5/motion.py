"""Planned motions of the arm: moves of joints and of the tool, and stops.

A motion returns once per tick the next planned angles, velocities and accelerations. Its time is slower than
real time when the speed slider is low.
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
"""Joint speed above which the safety system stops the arm, rad/s (UR5: 180°/s, with a tolerance)."""
JOINT_SPEED = 3.14159
"""Largest planned joint speed, rad/s."""
ACCELERATION_LIMIT = 40.0
"""Largest planned joint acceleration, rad/s², as in the client."""
MIN_RATE = 1e-4
"""Smallest speed and acceleration of a motion, rad/s or m/s and their rates."""
AT_REST = 1e-6
DIFFERENCE_STEP = 1e-4
"""Step of the central difference of a Jacobian, s."""


class MotionError(Exception):
    """A motion is out of reach, through a singularity, or too fast."""


class Plan(NamedTuple):
    """Planned angles, rad, rates, rad/s, and accelerations, rad/s², (6,) each."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray

    @classmethod
    def resting(cls, q: Sequence[float] | FloatArray) -> Plan:
        """Return the plan at rest at angles (6,) rad."""
        return cls(np.array(q, dtype=np.float64), np.zeros(6), np.zeros(6))


class Motion(Protocol):
    """A motion; ``done`` when it has ended."""

    done: bool

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan.

        Raises:
            MotionError: The arm cannot follow.
        """
        ...


class Trapezoid:
    """Trapezoidal profile from 0 to ``length`` with a speed and an acceleration."""

    def __init__(self, length: float, speed: float, acceleration: float) -> None:
        self.length = length
        self._a = max(acceleration, MIN_RATE)
        self._ramp = max(speed, MIN_RATE) / self._a
        if length < self._a * self._ramp**2:
            self._ramp = sqrt(length / self._a)
        top = self._a * self._ramp
        self._cruise = (length - top * self._ramp) / top if top > 0.0 else 0.0
        self.duration = 2.0 * self._ramp + self._cruise

    def at(self, t: float) -> tuple[float, float, float]:
        """Return position, speed and acceleration at t (s)."""
        a, ramp = self._a, self._ramp
        if t >= self.duration:
            return self.length, 0.0, 0.0
        if t < ramp:
            return 0.5 * a * t * t, a * t, a
        remaining = self.duration - t
        if remaining < ramp:
            return self.length - 0.5 * a * remaining * remaining, a * remaining, -a
        return a * ramp * (t - 0.5 * ramp), a * ramp, 0.0


class JointMove:
    """``movej``: all joints begin and end together; the farthest joint has speed and acceleration."""

    def __init__(self, begin: FloatArray, end: FloatArray, speed: float, acceleration: float) -> None:
        self._begin, self._end = begin.copy(), np.array(end, dtype=np.float64)
        self._displacement = self._end - self._begin
        max_distance = float(np.abs(self._displacement).max())
        self._share = self._displacement / max_distance if max_distance > 0.0 else np.zeros(6)
        self._profile = Trapezoid(
            max_distance, min(speed, JOINT_SPEED), min(acceleration, ACCELERATION_LIMIT)
        )
        self._t = 0.0
        self.done = False

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan."""
        self._t += h
        if self._t >= self._profile.duration:
            self.done = True
            return Plan.resting(self._end)
        s, sd, sdd = self._profile.at(self._t)
        return Plan(self._begin + self._share * s, self._share * sd, self._share * sdd)


class LineMove:
    """``movel``: the tool moves on a line and rotates about one axis, with v and a in m/s and m/s².

    Where the tool rotates by more rad than it moves by m, v and a are rad/s and rad/s² of the rotation.
    """

    def __init__(
        self, arm: Geometry, tool: Pose, begin: FloatArray, end: Pose, speed: float, acceleration: float
    ) -> None:
        self._arm, self._tool = arm, tool
        first = arm.pose(begin, tool)
        self._start = first[:3]
        self._displacement = np.subtract(end[:3], first[:3])
        self._rotation = rotation_of(*first[3:])
        self._rotation_vector = np.array(vector_of(times(transpose(self._rotation), rotation_of(*end[3:]))))
        length = max(float(np.linalg.norm(self._displacement)), float(np.linalg.norm(self._rotation_vector)))
        self._profile = Trapezoid(length, speed, acceleration)
        spin = rotate(
            self._rotation, (self._rotation_vector[0], self._rotation_vector[1], self._rotation_vector[2])
        )
        self._twist = np.array([*self._displacement, *spin]) / length if length > 0.0 else np.zeros(6)
        self._q = begin.copy()
        self._t = 0.0
        self.done = False

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan; MotionError out of reach or through a singularity."""
        self._t += h
        s, sd, sdd = self._profile.at(self._t)
        share = s / self._profile.length if self._profile.length > 0.0 else 1.0
        position = self._start + share * self._displacement
        rotation_vector = vector_of(times(self._rotation, rotation_of(*(share * self._rotation_vector))))
        q = self._arm.inverse((*position, *rotation_vector), self._q, self._tool)
        if q is None:
            raise MotionError("the tool's way leads out of the arm's reach")
        q_now = np.array(q)
        if np.abs(q_now - self._q).max() > SPEED_LIMIT * h + 1e-3:
            raise MotionError("the tool's way leads through a singularity: a joint would have to jump")
        self.done = self._t >= self._profile.duration
        self._q = q_now
        if self.done:
            return Plan.resting(q_now)
        qd = joint_rates(self._arm, q_now, self._tool, self._twist * sd)
        return Plan(q_now, qd, joint_accelerations(self._arm, q_now, qd, self._tool, self._twist * sdd))


class Halt:
    """``stopj`` and ``stopl``: a constant deceleration along the direction of the joint rates."""

    def __init__(self, q_now: Plan, time: float) -> None:
        self._q, self._initial_rates = q_now.q.copy(), q_now.qd.copy()
        self._time = time
        self._t = 0.0
        self.done = time <= 0.0

    @classmethod
    def of_joints(cls, q_now: Plan, deceleration: float) -> Halt:
        """Stop with a deceleration of the fastest joint, rad/s²."""
        fastest = float(np.abs(q_now.qd).max())
        if fastest < AT_REST:
            return cls(q_now, 0.0)
        return cls(q_now, fastest / min(max(deceleration, MIN_RATE), ACCELERATION_LIMIT))

    @classmethod
    def of_tool(cls, q_now: Plan, deceleration: float, arm: Geometry, tool: Pose) -> Halt:
        """Stop with a deceleration of the tool, m/s² (or rad/s² of its rotation, if that takes longer)."""
        if float(np.abs(q_now.qd).max()) < AT_REST:
            return cls(q_now, 0.0)
        twist = arm.jacobian(q_now.q, tool) @ q_now.qd
        speed = max(float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:])))
        shortest = float(np.abs(q_now.qd).max()) / ACCELERATION_LIMIT
        return cls(q_now, max(speed / max(deceleration, MIN_RATE), shortest))

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan."""
        self._t = min(self._t + h, self._time)
        if self._t >= self._time:
            self.done = True
            return Plan.resting(self._q + 0.5 * self._time * self._initial_rates)
        remaining = 1.0 - self._t / self._time
        q = self._q + self._initial_rates * (self._t - 0.5 * self._t**2 / self._time)
        return Plan(q, self._initial_rates * remaining, -self._initial_rates / self._time)


def joint_rates(arm: Geometry, q: FloatArray, tool: Pose, twist: FloatArray) -> FloatArray:
    """Return the joint rates (6,) rad/s for a velocity of the tool (6,).

    Raises:
        MotionError: The position is near a singularity.
    """
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
    """Return the joint accelerations (6,) rad/s² for an acceleration of the tool, away from singularities.

    q̈ = J⁻¹·(a − J̇·q̇), with J̇·q̇ by a central difference along the joint rates.
    """
    step = DIFFERENCE_STEP * qd
    turning = (arm.jacobian(q + step, tool) - arm.jacobian(q - step, tool)) @ qd / (2.0 * DIFFERENCE_STEP)
    return np.asarray(np.linalg.solve(arm.jacobian(q, tool), acceleration - turning), dtype=np.float64)


def step_towards(q_now: FloatArray, target: FloatArray, step: float) -> FloatArray:
    """Step towards a target on a straight line; the farthest component changes by at most ``step``."""
    difference = target - q_now
    max_distance = float(np.abs(difference).max())
    return target.copy() if max_distance <= step else q_now + difference * (step / max_distance)
