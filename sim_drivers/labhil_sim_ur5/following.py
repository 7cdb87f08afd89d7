"""Motions without an end, which follow a set point that a program may change at any tick."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np

from labhil_sim_ur5.kinematics import Geometry
from labhil_sim_ur5.motion import (
    ACCELERATION_LIMIT,
    JOINT_SPEED,
    MIN_RATE,
    Plan,
    joint_accelerations,
    joint_rates,
    step_towards,
)
from labhil_sim_ur5.poses import Pose, rotate, rotation_of, times, transpose, vector_of

SPEED_LIMIT_TIME = 0.02
"""Time in which the servo approaches the largest joint speed without overshoot, s."""


class Servo:
    """``servoj``: the plan follows a set point.

    q̈ = gain·(q_set − q − lookahead·q̇), within the joints' limits: natural frequency √gain rad/s, damping
    ½·lookahead·√gain, lag ``lookahead`` behind a ramp. The manufacturer does not publish its law; this one
    has its two parameters with the documented effect: more gain is stiffer, more lookahead smoother.
    """

    def __init__(self, now: Plan) -> None:
        self._plan = now
        self._target = now.q.copy()
        self._gain, self._lookahead = 300.0, 0.1
        self.done = False

    def set_target(self, q: Sequence[float], lookahead: float, gain: float) -> None:
        """Set the target angles (6,) rad."""
        self._target = np.array(q, dtype=np.float64)
        self._lookahead, self._gain = min(max(lookahead, 0.03), 0.2), min(max(gain, 100.0), 2000.0)

    def advance(self, h: float) -> Plan:
        """Advance by h (s), by an implicit step with a linear acceleration, and return the plan.

        Angle, velocity and acceleration belong to one time; a torque that is late by half a tick would look
        like an offset of the clock.
        """
        k, lookahead, (q, qd, qdd) = self._gain, self._lookahead, self._plan
        q = q + h * qd + (h * h / 3.0) * qdd
        previous, qd = qd, qd + 0.5 * h * qdd
        target = k * (self._target - q - lookahead * qd) / (1.0 + k * h * (0.5 * lookahead + h / 6.0))
        target = np.clip(
            target, (-JOINT_SPEED - previous) / SPEED_LIMIT_TIME, (JOINT_SPEED - previous) / SPEED_LIMIT_TIME
        )
        target = np.clip(target, -ACCELERATION_LIMIT, ACCELERATION_LIMIT)
        self._plan = Plan(q + (h * h / 6.0) * target, qd + 0.5 * h * target, target)
        return self._plan


class JointSpeed:
    """``speedj``: joint velocities, reached together with a constant acceleration of the largest change."""

    def __init__(self, now: Plan) -> None:
        self._q, self._qd = now.q.copy(), now.qd.copy()
        self._target, self._a = self._qd.copy(), 0.5
        self.done = False

    def set_target(self, qd: Sequence[float], acceleration: float) -> None:
        """Set the target velocities (6,) rad/s and the acceleration, rad/s²."""
        self._target = np.clip(np.array(qd, dtype=np.float64), -JOINT_SPEED, JOINT_SPEED)
        self._a = min(max(acceleration, MIN_RATE), ACCELERATION_LIMIT)

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan."""
        previous = self._qd
        self._qd = step_towards(previous, self._target, self._a * h)
        self._q = self._q + 0.5 * h * (previous + self._qd)
        return Plan(self._q.copy(), self._qd.copy(), (self._qd - previous) / h)


class ToolSpeed:
    """``speedl``: velocity and rate of the tool (6,) m/s and rad/s in the base's frame."""

    def __init__(self, now: Plan, arm: Geometry, tool: Pose) -> None:
        self._arm, self._tool, self._plan = arm, tool, now
        self._twist = arm.jacobian(now.q, tool) @ now.qd
        self._target, self._a = self._twist.copy(), 0.25
        self.done = False

    def set_target(self, twist: Sequence[float], acceleration: float) -> None:
        """Set the target velocity (6,) and the acceleration, m/s² (rad/s² of the rotation)."""
        self._target = np.array(twist, dtype=np.float64)
        self._a = max(acceleration, MIN_RATE)

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan; MotionError near a singularity."""
        twist, self._twist = self._twist, step_towards(self._twist, self._target, self._a * h)
        q, before_qd, before_qdd = self._plan
        ahead = q + h * before_qd + 0.5 * h * h * before_qdd
        qd = joint_rates(self._arm, ahead, self._tool, self._twist)
        q = q + 0.5 * h * (before_qd + qd)
        qdd = joint_accelerations(self._arm, q, qd, self._tool, (self._twist - twist) / h)
        self._plan = Plan(q, qd, qdd)
        return self._plan


class Approach:
    """``servoc``: the tool moves straight to a target pose and slows down there."""

    def __init__(self, now: Plan, arm: Geometry, tool: Pose) -> None:
        self._arm, self._tool = arm, tool
        self._speed = ToolSpeed(now, arm, tool)
        self._plan = now
        self._target = arm.pose(now.q, tool)
        self._v, self._a = 0.25, 1.2
        self.done = False

    def set_target(self, pose: Pose, speed: float, acceleration: float) -> None:
        """Set the target pose, the speed, m/s, and the acceleration, m/s²."""
        self._target = pose
        self._v, self._a = max(speed, MIN_RATE), max(acceleration, MIN_RATE)

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan; MotionError near a singularity."""
        pose = self._arm.pose(self._plan.q, self._tool)
        rotation = rotation_of(*pose[3:])
        rotation_vector = vector_of(times(transpose(rotation), rotation_of(*self._target[3:])))
        difference = np.array([*np.subtract(self._target[:3], pose[:3]), *rotate(rotation, rotation_vector)])
        distance = max(float(np.linalg.norm(difference[:3])), float(np.linalg.norm(difference[3:])))
        # at half the necessary deceleration, so that a delay of one tick causes no overshoot
        speed = min(self._v, sqrt(self._a * distance), 0.5 * distance / h)
        twist = difference * (speed / distance) if distance > 0.0 else np.zeros(6)
        self._speed.set_target(twist.tolist(), 2.0 * self._a)
        self._plan = self._speed.advance(h)
        return self._plan
