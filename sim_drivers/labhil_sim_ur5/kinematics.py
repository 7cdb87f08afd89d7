"""Forward and inverse kinematics and Jacobian of UR arms, in closed form.

These arms have three parallel axes (shoulder, elbow, first wrist) and a wrist whose axes intersect in pairs;
in standard Denavit-Hartenberg parameters only d1, a2, a3, d4, d5, d6 differ between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import acos, atan2, cos, hypot, pi, sin, sqrt

import numpy as np

from labhil.compiled import compiled
from labhil.errors import UsageError
from labhil.plants.arm.links import Links
from labhil.signals import FloatArray
from labhil_sim_ur5.poses import (
    NO_OFFSET,
    Point,
    Pose,
    Rotation,
    inverse,
    nearest_turn,
    pose_times,
    rotate,
    rotation_of,
    vector_of,
)

Joints = tuple[float, float, float, float, float, float]
Joints6 = Sequence[float] | FloatArray
"""Six angles or rates."""

JOINT_LIMIT = 2.0 * pi
"""Largest joint angle in both directions, rad."""
MIN_WRIST_SINE = 1e-6
"""Sine of joint 4 (from 0) below which the last joint's angle is undetermined."""
REACH_TOLERANCE = 1e-9
_TWIST_ANGLES = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)


@dataclass(frozen=True, slots=True)
class Geometry:
    """Lengths of the arm, m."""

    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float

    @classmethod
    def from_links(cls, links: Links) -> Geometry:
        """Return the lengths in a table of links.

        Raises:
            UsageError: The arm is not of this class.
        """
        if any(
            abs(link.alpha - angle) > 1e-9 for link, angle in zip(links.links, _TWIST_ANGLES, strict=True)
        ):
            raise UsageError(f"links of {links.name}: the twin's kinematics need a UR arm's twist angles")
        one, two, three, four, five, six = links.links
        return cls(one.d, two.a, three.a, four.d, five.d, six.d)

    def flange(self, q: Joints6) -> tuple[Point, Rotation]:
        """Return position (m) and rotation of the flange in the base's frame at joint angles (6,) rad."""
        c1, s1, c5, s5, c6, s6 = cos(q[0]), sin(q[0]), cos(q[4]), sin(q[4]), cos(q[5]), sin(q[5])
        q23 = q[1] + q[2]
        c, s = cos(q23 + q[3]), sin(q23 + q[3])
        reach = self.a2 * cos(q[1]) + self.a3 * cos(q23) + self.d5 * s
        x, y = s1 * s5 + c1 * c * c5, s1 * c * c5 - c1 * s5
        zx, zy, zz = c5 * s1 - c1 * c * s5, -c1 * c5 - s1 * c * s5, -s * s5
        position = (
            self.d6 * zx + self.d4 * s1 + c1 * reach,
            self.d6 * zy - self.d4 * c1 + s1 * reach,
            self.d1 + self.d6 * zz + self.a2 * sin(q[1]) + self.a3 * sin(q23) - self.d5 * c,
        )
        return position, (
            c6 * x - s6 * c1 * s, -s6 * x - c6 * c1 * s, zx,
            c6 * y - s6 * s1 * s, -s6 * y - c6 * s1 * s, zy,
            c * s6 + c5 * c6 * s, c * c6 - c5 * s6 * s, zz,
        )  # fmt: skip

    def pose(self, q: Joints6, tool: Pose = NO_OFFSET) -> Pose:
        """Return the tool's pose at joint angles (6,) rad; ``tool`` is its pose on the flange."""
        position, rotation = self.flange(q)
        flange: Pose = (*position, *vector_of(rotation))
        return flange if tool == NO_OFFSET else pose_times(flange, tool)

    def elbow(self, q: Joints6, qd: Joints6) -> tuple[Point, Point]:
        """Return position (m) and velocity (m/s) of the elbow in the base's frame."""
        c1, s1, c2, s2 = cos(q[0]), sin(q[0]), cos(q[1]), sin(q[1])
        out, up = self.a2 * c2, self.a2 * s2
        position = (c1 * out, s1 * out, self.d1 + up)
        velocity = (-s1 * out * qd[0] - c1 * up * qd[1], c1 * out * qd[0] - s1 * up * qd[1], out * qd[1])
        return position, (float(velocity[0]), float(velocity[1]), float(velocity[2]))

    def jacobian(self, q: Joints6, tool: Pose = NO_OFFSET) -> FloatArray:
        """Return the Jacobian (6, 6): velocity (m/s) and rate (rad/s) of the tool per joint rate."""
        position, rotation = self.flange(q)
        if tool != NO_OFFSET:
            x, y, z = rotate(rotation, tool[:3])
            position = (position[0] + x, position[1] + y, position[2] + z)
        columns = np.empty((6, 6))
        axis = (rotation[2], rotation[5], rotation[8])
        lengths = (self.d1, self.a2, self.a3, self.d4, self.d5)
        jacobian_columns(
            lengths, (float(q[0]), float(q[1]), float(q[2]), float(q[3])), axis, position, columns
        )
        return columns.T

    def inverse(self, pose: Pose, near: Joints6, tool: Pose = NO_OFFSET) -> Joints | None:
        """Return the joint angles for a pose of the tool that are nearest to ``near`` (6,) rad.

        Returns None where the pose is out of reach.
        """
        flange = pose if tool == NO_OFFSET else pose_times(pose, inverse(tool))
        solutions = self.solutions(flange, near)
        return min(solutions, key=lambda q: _distance(q, near), default=None)

    def solutions(self, flange: Pose, near: Joints6) -> list[Joints]:
        """Return all joint angles (up to eight) for a pose of the flange, each turned towards ``near``."""
        r = rotation_of(*flange[3:])
        solutions = []
        for first in self._solve_first_joint(flange, r):
            c1, s1 = cos(first), sin(first)
            cosine = (flange[0] * s1 - flange[1] * c1 - self.d4) / self.d6
            if abs(cosine) > 1.0 + REACH_TOLERANCE / self.d6:
                continue
            bend = acos(min(max(cosine, -1.0), 1.0))
            for fifth in (bend, -bend):
                last = _solve_last_joint(r, c1, s1, sin(fifth), near[5])
                solutions += [
                    (first, second, third, fourth, fifth, last)
                    for second, third, fourth in self._solve_parallel_joints(
                        flange, r, c1, s1, sin(fifth), last
                    )
                ]
        return [_turn_towards(q, near) for q in solutions]

    def _solve_first_joint(self, flange: Pose, r: Rotation) -> tuple[float, ...]:
        x, y = flange[0] - self.d6 * r[2], flange[1] - self.d6 * r[5]
        distance = hypot(x, y)
        if distance < abs(self.d4) - REACH_TOLERANCE or distance == 0.0:
            return ()
        open_angle = acos(min(max(self.d4 / distance, -1.0), 1.0))
        towards = atan2(y, x) + pi / 2
        return (towards + open_angle, towards - open_angle)

    def _solve_parallel_joints(
        self, flange: Pose, r: Rotation, c1: float, s1: float, s5: float, last: float
    ) -> Iterator[tuple[float, float, float]]:
        """Angles of the three parallel joints, given the others."""
        c6, s6 = cos(last), sin(last)
        c = s6 * r[6] + c6 * r[7]
        s = -(s6 * (c1 * r[0] + s1 * r[3]) + c6 * (c1 * r[1] + s1 * r[4]))
        x = c1 * flange[0] + s1 * flange[1] + self.d6 * c * s5 - self.d5 * s
        z = flange[2] - self.d1 + self.d6 * s * s5 + self.d5 * c
        cosine = (x * x + z * z - self.a2**2 - self.a3**2) / (2.0 * self.a2 * self.a3)
        if abs(cosine) > 1.0 + REACH_TOLERANCE:
            return
        bend = acos(min(max(cosine, -1.0), 1.0))
        for third in (bend, -bend):
            second = atan2(z, x) - atan2(self.a3 * sin(third), self.a2 + self.a3 * cos(third))
            yield second, third, atan2(s, c) - second - third


def _solve_last_joint(r: Rotation, c1: float, s1: float, s5: float, near: float) -> float:
    if abs(s5) < MIN_WRIST_SINE:
        return near
    return atan2((r[4] * c1 - r[1] * s1) / s5, (r[0] * s1 - r[3] * c1) / s5)


def _turn_towards(q: Joints, near: Joints6) -> Joints:
    a, b, c, d, e, f = (nearest_turn(x, y, JOINT_LIMIT) for x, y in zip(q, near, strict=True))
    return (a, b, c, d, e, f)


def _distance(q: Joints6, near: Joints6) -> float:
    return sqrt(sum((x - y) ** 2 for x, y in zip(q, near, strict=True)))


@compiled
def jacobian_columns(
    lengths: tuple[float, float, float, float, float],
    q: tuple[float, float, float, float],
    last: Point,
    position: Point,
    out: FloatArray,
) -> None:
    """Write one row (6,) per joint: z × r and z, with its axis z and the vector r from it to ``position``."""
    d1, a2, a3, d4, d5 = lengths
    c1, s1, q23 = cos(q[0]), sin(q[0]), q[1] + q[2]
    c, s = cos(q23 + q[3]), sin(q23 + q[3])
    elbow, height = a2 * cos(q[1]), d1 + a2 * sin(q[1])
    wrist, top = elbow + a3 * cos(q23), height + a3 * sin(q23)
    x, y = c1 * wrist + d4 * s1, s1 * wrist - d4 * c1
    axes = ((0.0, 0.0, 1.0), (s1, -c1, 0.0), (s1, -c1, 0.0), (s1, -c1, 0.0), (c1 * s, s1 * s, -c), last)
    points = (
        (0.0, 0.0, 0.0),
        (0.0, 0.0, d1),
        (c1 * elbow, s1 * elbow, height),
        (c1 * wrist, s1 * wrist, top),
        (x, y, top),
        (x + d5 * c1 * s, y + d5 * s1 * s, top - d5 * c),
    )
    for j in range(6):
        ax, ay, az = axes[j]
        rx, ry, rz = position[0] - points[j][0], position[1] - points[j][1], position[2] - points[j][2]
        out[j, 0], out[j, 1], out[j, 2] = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
        out[j, 3], out[j, 4], out[j, 5] = ax, ay, az
