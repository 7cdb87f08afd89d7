"""Inverse dynamics of a tree of rigid bodies on hinges, linear in inertial parameters: τ = Y(q, q̇, q̈; g)·π.

Frame i is fixed to link i, with its origin on the axis of joint i. At q_i = 0 it is rotated by ``turn[i]``
and displaced by ``offset[i]`` from the frame of its parent link ``carrier[i]`` (−1: the base); joint i then
rotates it about ``axis[i]``. Equations, symbols and the order of π are those of ``physics.arm.rigid_body``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.compiled import inlined
from labhil.physics.arm.rigid_body import PER_LINK, newton_euler, wrench_at
from labhil.signals import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """A tree of rigid bodies (implements ``physics.arm.chain.Chain``).

    Attributes:
        carrier: Parent link of each link, (n,); −1 is the base.
        turn: Rotation of each frame in that of its parent at angle zero, (n, 3, 3).
        offset: Origin of each frame in that of its parent, (n, 3), m.
        axis: Unit vector of each joint's axis in its frame, (n, 3).
        begin: Inertial parameters of the description, (10 n,), SI.
        inertial: The same if they count as known, else None.
    """

    carrier: IntArray
    turn: FloatArray
    offset: FloatArray
    axis: FloatArray
    begin: FloatArray
    inertial: FloatArray | None = None

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.carrier)

    @property
    def on_base(self) -> list[int]:
        """Joints whose parent is the base."""
        return [j for j, carrier in enumerate(self.carrier) if carrier < 0]

    def loaded(self, link: int) -> Sequence[int]:
        """Joints between the base and a link."""
        path = []
        while link >= 0:
            path.append(link)
            link = int(self.carrier[link])
        return sorted(path)

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray) -> FloatArray:
        """Torque per inertial parameter (m, n, 10 n) of a motion (m, n); ``gravity`` (3,), m/s²."""
        n = self.joints
        out = np.zeros((len(q), n, n * PER_LINK))
        q, qd, qdd = np.ascontiguousarray(q), np.ascontiguousarray(qd), np.ascontiguousarray(qdd)
        regressor_of_tree(self.carrier, self.turn, self.offset, self.axis, q, qd, qdd, gravity, out)
        return out

    def torques(
        self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray, inertial: FloatArray
    ) -> FloatArray:
        """Torques (m, n), N·m, of a motion at inertial parameters (10 n,)."""
        out = np.zeros((len(q), self.joints))
        q, qd, qdd = np.ascontiguousarray(q), np.ascontiguousarray(qd), np.ascontiguousarray(qdd)
        pi = np.ascontiguousarray(inertial)
        torques_of_tree(self.carrier, self.turn, self.offset, self.axis, q, qd, qdd, gravity, pi, out)
        return out


@inlined
def torques_of_tree(
    carrier: IntArray,
    turn: FloatArray,
    offset: FloatArray,
    axis: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    gravity: FloatArray,
    inertial: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (m, n) with torques; parents come before their children."""
    joints = carrier.size
    rotation, moving = np.empty((joints, 3, 3)), np.empty((joints, 3, 3))
    wrench, loads, load = np.empty((6, PER_LINK)), np.empty((joints, 6)), np.empty((6, 1))
    for m in range(q.shape[0]):
        for i in range(joints):
            rotate(turn[i], axis[i], q[m, i], rotation[i])
            carry(carrier[i], moving, gravity, rotation[i], offset[i], moving[i])
            add_hinge(axis[i], qd[m, i], qdd[m, i], moving[i])
            newton_euler(moving[i, 0], moving[i, 1], moving[i, 2], wrench)
            wrench_at(wrench, inertial, i, loads[i])
        for i in range(joints - 1, -1, -1):
            out[m, i] = axis[i, 0] * loads[i, 3] + axis[i, 1] * loads[i, 4] + axis[i, 2] * loads[i, 5]
            if carrier[i] >= 0:
                for k in range(6):
                    load[k, 0] = loads[i, k]
                hand_down(rotation[i], offset[i], load)
                for k in range(6):
                    loads[carrier[i], k] += load[k, 0]


@inlined
def regressor_of_tree(
    carrier: IntArray,
    turn: FloatArray,
    offset: FloatArray,
    axis: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    gravity: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (m, n, 10 n), initially zero, with the regressor."""
    joints = carrier.size
    rotation = np.empty((joints, 3, 3))
    moving = np.empty((joints, 3, 3))
    wrench = np.empty((6, PER_LINK))
    for m in range(q.shape[0]):
        for i in range(joints):
            rotate(turn[i], axis[i], q[m, i], rotation[i])
            carry(carrier[i], moving, gravity, rotation[i], offset[i], moving[i])
            add_hinge(axis[i], qd[m, i], qdd[m, i], moving[i])
            newton_euler(moving[i, 0], moving[i, 1], moving[i, 2], wrench)
            j = i
            while j >= 0:
                for c in range(PER_LINK):
                    out[m, j, PER_LINK * i + c] = (
                        axis[j, 0] * wrench[3, c] + axis[j, 1] * wrench[4, c] + axis[j, 2] * wrench[5, c]
                    )
                hand_down(rotation[j], offset[j], wrench)
                j = carrier[j]


@inlined
def rotate(turn: FloatArray, axis: FloatArray, q: float, out: FloatArray) -> None:
    """``out`` (3, 3) = turn · rotation by q about the unit vector ``axis`` (Rodrigues)."""
    s, c = np.sin(q), np.cos(q)
    x, y, z = axis[0], axis[1], axis[2]
    v = 1.0 - c
    for k in range(3):
        a, b, d = turn[k, 0], turn[k, 1], turn[k, 2]
        out[k, 0] = a * (c + x * x * v) + b * (x * y * v + z * s) + d * (x * z * v - y * s)
        out[k, 1] = a * (x * y * v - z * s) + b * (c + y * y * v) + d * (y * z * v + x * s)
        out[k, 2] = a * (x * z * v + y * s) + b * (y * z * v - x * s) + d * (c + z * z * v)


@inlined
def carry(
    carrier: int,
    moving: FloatArray,
    gravity: FloatArray,
    rotation: FloatArray,
    p: FloatArray,
    out: FloatArray,
) -> None:
    """Propagate angular velocity, angular and linear acceleration (rows of ``out``) from the parent."""
    wx, wy, wz, bx, by, bz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ax, ay, az = -gravity[0], -gravity[1], -gravity[2]
    if carrier >= 0:
        of = moving[carrier]
        wx, wy, wz = of[0, 0], of[0, 1], of[0, 2]
        bx, by, bz = of[1, 0], of[1, 1], of[1, 2]
        ax, ay, az = of[2, 0], of[2, 1], of[2, 2]
    dot, square = wx * p[0] + wy * p[1] + wz * p[2], wx * wx + wy * wy + wz * wz
    ax += by * p[2] - bz * p[1] + wx * dot - p[0] * square
    ay += bz * p[0] - bx * p[2] + wy * dot - p[1] * square
    az += bx * p[1] - by * p[0] + wz * dot - p[2] * square
    for k in range(3):
        x, y, z = rotation[0, k], rotation[1, k], rotation[2, k]
        out[0, k] = x * wx + y * wy + z * wz
        out[1, k] = x * bx + y * by + z * bz
        out[2, k] = x * ax + y * ay + z * az


@inlined
def add_hinge(axis: FloatArray, qd: float, qdd: float, of: FloatArray) -> None:
    """Add the rotation of the joint to a motion, in place."""
    x, y, z = axis[0], axis[1], axis[2]
    wx, wy, wz = of[0, 0], of[0, 1], of[0, 2]
    of[1, 0] += qdd * x + qd * (wy * z - wz * y)
    of[1, 1] += qdd * y + qd * (wz * x - wx * z)
    of[1, 2] += qdd * z + qd * (wx * y - wy * x)
    of[0, 0], of[0, 1], of[0, 2] = wx + qd * x, wy + qd * y, wz + qd * z


@inlined
def hand_down(r: FloatArray, p: FloatArray, wrench: FloatArray) -> None:
    """Transform forces and moments from the origin of a link to that of its parent."""
    for c in range(wrench.shape[1]):
        f, g, h = wrench[0, c], wrench[1, c], wrench[2, c]
        x, y, z = wrench[3, c], wrench[4, c], wrench[5, c]
        for k in range(3):
            wrench[k, c] = r[k, 0] * f + r[k, 1] * g + r[k, 2] * h
            wrench[3 + k, c] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z
        f, g, h = wrench[0, c], wrench[1, c], wrench[2, c]
        wrench[3, c] += p[1] * h - p[2] * g
        wrench[4, c] += p[2] * f - p[0] * h
        wrench[5, c] += p[0] * g - p[1] * f
