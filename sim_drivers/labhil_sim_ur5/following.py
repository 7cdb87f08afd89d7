"""Motions without an end: they follow set points that a program gives at any tick."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np

from labhil_sim_ur5.kinematics import Geometry
from labhil_sim_ur5.motion import (
    ACCELERATION_LIMIT,
    JOINT_SPEED,
    SLOWEST,
    Plan,
    joint_accelerations,
    joint_rates,
    towards,
)
from labhil_sim_ur5.poses import Pose, rotate, rotation_of, times, transpose, vector_of

EASING = 0.02
"""In what time (s) the servo eases into the joints' greatest speed, so that it does not overshoot it."""


class Servo:
    """``servoj``: the plan follows a set point that may change at any tick.

    q̈ = gain·(q_set − q − lookahead·q̇), within the joints' limits: natural frequency √gain rad/s, damping
    ½·lookahead·√gain, lag ``lookahead`` behind a ramp. The manufacturer does not publish its own law; this
    one has its two numbers and what is said of them: more gain is stiffer, more lookahead smoother.
    """

    def __init__(self, now: Plan) -> None:
        self._now = now
        self._set = now.q.copy()
        self._gain, self._lookahead = 300.0, 0.1
        self.done = False

    def aim(self, q: Sequence[float], lookahead: float, gain: float) -> None:
        """Set the angles (6,) to go to."""
        self._set = np.array(q, dtype=np.float64)
        self._lookahead, self._gain = min(max(lookahead, 0.03), 0.2), min(max(gain, 100.0), 2000.0)

    def advance(self, h: float) -> Plan:
        """Let h (s) pass, by an implicit step in which the acceleration goes along a straight line.

        So angle, velocity and acceleration belong to one moment: what is planned is what drives the arm,
        and a torque half a tick late would look like a clock that is.
        """
        k, lookahead, (q, qd, qdd) = self._gain, self._lookahead, self._now
        q = q + h * qd + (h * h / 3.0) * qdd
        before, qd = qd, qd + 0.5 * h * qdd
        target = k * (self._set - q - lookahead * qd) / (1.0 + k * h * (0.5 * lookahead + h / 6.0))
        target = np.clip(target, (-JOINT_SPEED - before) / EASING, (JOINT_SPEED - before) / EASING)
        target = np.clip(target, -ACCELERATION_LIMIT, ACCELERATION_LIMIT)
        self._now = Plan(q + (h * h / 6.0) * target, qd + 0.5 * h * target, target)
        return self._now


class JointSpeed:
    """``speedj``: joint velocities, reached together with a steady acceleration of the fastest to change."""

    def __init__(self, now: Plan) -> None:
        self._q, self._qd = now.q.copy(), now.qd.copy()
        self._set, self._a = self._qd.copy(), 0.5
        self.done = False

    def aim(self, qd: Sequence[float], acceleration: float) -> None:
        """Set the velocities (6,) rad/s to go to, and how fast (rad/s²)."""
        self._set = np.clip(np.array(qd, dtype=np.float64), -JOINT_SPEED, JOINT_SPEED)
        self._a = min(max(acceleration, SLOWEST), ACCELERATION_LIMIT)

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then."""
        before = self._qd
        self._qd = towards(before, self._set, self._a * h)
        self._q = self._q + 0.5 * h * (before + self._qd)
        return Plan(self._q.copy(), self._qd.copy(), (self._qd - before) / h)


class ToolSpeed:
    """``speedl``: velocity and rate of the tool (6,) m/s and rad/s in the base's frame."""

    def __init__(self, now: Plan, arm: Geometry, tool: Pose) -> None:
        self._arm, self._tool, self._now = arm, tool, now
        self._twist = arm.jacobian(now.q, tool) @ now.qd
        self._set, self._a = self._twist.copy(), 0.25
        self.done = False

    def aim(self, twist: Sequence[float], acceleration: float) -> None:
        """Set the velocity to go to, and how fast: m/s² (rad/s² of the turn)."""
        self._set = np.array(twist, dtype=np.float64)
        self._a = max(acceleration, SLOWEST)

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then; MotionError near a singularity."""
        twist, self._twist = self._twist, towards(self._twist, self._set, self._a * h)
        q, before_qd, before_qdd = self._now
        ahead = q + h * before_qd + 0.5 * h * h * before_qdd
        qd = joint_rates(self._arm, ahead, self._tool, self._twist)
        q = q + 0.5 * h * (before_qd + qd)
        qdd = joint_accelerations(self._arm, q, qd, self._tool, (self._twist - twist) / h)
        self._now = Plan(q, qd, qdd)
        return self._now


class Approach:
    """``servoc``: the tool goes straight to a pose that may change, and slows down there."""

    def __init__(self, now: Plan, arm: Geometry, tool: Pose) -> None:
        self._arm, self._tool = arm, tool
        self._speed = ToolSpeed(now, arm, tool)
        self._plan = now
        self._set = arm.pose(now.q, tool)
        self._v, self._a = 0.25, 1.2
        self.done = False

    def aim(self, pose: Pose, speed: float, acceleration: float) -> None:
        """Set the pose to go to, m/s and m/s²."""
        self._set = pose
        self._v, self._a = max(speed, SLOWEST), max(acceleration, SLOWEST)

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then; MotionError near a singularity."""
        pose = self._arm.pose(self._plan.q, self._tool)
        rotation = rotation_of(*pose[3:])
        turn = vector_of(times(transpose(rotation), rotation_of(*self._set[3:])))
        missing = np.array([*np.subtract(self._set[:3], pose[:3]), *rotate(rotation, turn)])
        distance = max(float(np.linalg.norm(missing[:3])), float(np.linalg.norm(missing[3:])))
        # at half the deceleration that would do, so that one tick's delay does not carry it beyond
        speed = min(self._v, sqrt(self._a * distance), 0.5 * distance / h)
        twist = missing * (speed / distance) if distance > 0.0 else np.zeros(6)
        self._speed.aim(twist.tolist(), 2.0 * self._a)
        self._plan = self._speed.advance(h)
        return self._plan
