"""Inverse dynamics of a rigid arm, linear in the inertial parameters of its links: τ = Y(q, q̇, q̈; g)·π.

τ are joint torques (N·m), Y is the regressor, q, q̇, q̈ is the motion (rad, rad/s, rad/s²), g gravity (m/s²).
π holds ten numbers per link: m, m·c_x, m·c_y, m·c_z (kg, kg·m), I_xx, I_yy, I_zz, I_xy, I_xz, I_yz (kg·m²),
about the origin of the link's frame. The recursion applies Newton's and Euler's equations to each link and
propagates wrenches to the base (Atkeson, An and Hollerbach 1986).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labhil.compiled import inlined
from labhil.kinds import JOINTS
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.physics.arm.links import Links

PER_LINK = 10
"""Number of inertial parameters of a link."""

GRAVITY = 9.81
"""m/s²."""


def gravity_in_base(roll: float = 0.0, pitch: float = 0.0) -> FloatArray:
    """Gravity in the frame of the base.

    Args:
        roll: Rotation of the base about x, rad.
        pitch: Rotation about the y axis of the floor, after the roll, rad.

    Returns:
        Gravity, (3,), m/s².
    """
    level = GRAVITY * np.cos(pitch)
    return np.array([GRAVITY * np.sin(pitch), -level * np.sin(roll), -level * np.cos(roll)])


def regressor(
    links: Links, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray
) -> FloatArray:
    """Regressor Y of a motion.

    Args:
        links: The links.
        q: Angles, (n, 6), rad.
        qd: Velocities, (n, 6), rad/s.
        qdd: Accelerations, (n, 6), rad/s².
        gravity: Gravity in the frame of the base, (3,), m/s².

    Returns:
        Torque per inertial parameter, (n, 6, 60).
    """
    out = np.zeros((len(q), JOINTS, JOINTS * PER_LINK))
    q, qd, qdd = np.ascontiguousarray(q), np.ascontiguousarray(qd), np.ascontiguousarray(qdd)
    regressor_of_links(links.d, links.a, links.alpha, q, qd, qdd, gravity, out)
    return out


def torques(
    links: Links, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray, inertial: FloatArray
) -> FloatArray:
    """Torques Y·π of a motion without computing Y.

    Args:
        links: The links.
        q: Angles, (n, 6), rad.
        qd: Velocities, (n, 6), rad/s.
        qdd: Accelerations, (n, 6), rad/s².
        gravity: Gravity in the frame of the base, (3,), m/s².
        inertial: Inertial parameters π, (60,), SI.

    Returns:
        Torques, (n, 6), N·m.
    """
    out = np.zeros((len(q), JOINTS))
    q, qd, qdd = np.ascontiguousarray(q), np.ascontiguousarray(qd), np.ascontiguousarray(qdd)
    pi = np.ascontiguousarray(inertial)
    torques_of_links(links.d, links.a, links.alpha, q, qd, qdd, gravity, pi, out)
    return out


@inlined
def torques_of_links(
    d: FloatArray,
    a: FloatArray,
    alpha: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    gravity: FloatArray,
    inertial: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (n, 6) with :func:`torques`."""
    rotation = np.empty((6, 3, 3))
    step = np.empty((6, 3))
    w, dw, acc = np.empty(3), np.empty(3), np.empty(3)
    wrench, loads, total = np.empty((6, PER_LINK)), np.empty((6, 6)), np.empty((6, 1))
    for n in range(q.shape[0]):
        w[:] = 0.0
        dw[:] = 0.0
        for k in range(3):
            acc[k] = -gravity[k]
        for i in range(6):
            _turn(q[n, i], alpha[i], rotation[i])
            _place(d[i], a[i], alpha[i], step[i])
            _next(rotation[i], step[i], qd[n, i], qdd[n, i], w, dw, acc)
            newton_euler(w, dw, acc, wrench)
            wrench_at(wrench, inertial, i, loads[i])
        total[:, 0] = 0.0
        for j in range(5, -1, -1):
            for k in range(6):
                total[k, 0] += loads[j, k]
            _carry(rotation[j], step[j], total)
            out[n, j] = total[5, 0]


@inlined
def wrench_at(wrench: FloatArray, inertial: FloatArray, link: int, out: FloatArray) -> None:
    """Fill ``out`` (6,) with force and moment of a link at its inertial parameters."""
    for k in range(6):
        out[k] = 0.0
        for c in range(PER_LINK):
            out[k] += wrench[k, c] * inertial[PER_LINK * link + c]


@inlined
def regressor_of_links(
    d: FloatArray,
    a: FloatArray,
    alpha: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    gravity: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (n, 6, 60), initially zero, with :func:`regressor`."""
    rotation = np.empty((6, 3, 3))
    step = np.empty((6, 3))
    w, dw, acc = np.empty(3), np.empty(3), np.empty(3)
    wrench = np.empty((6, 10))
    for n in range(q.shape[0]):
        w[:] = 0.0
        dw[:] = 0.0
        for k in range(3):
            acc[k] = -gravity[k]
        for i in range(6):
            _turn(q[n, i], alpha[i], rotation[i])
            _place(d[i], a[i], alpha[i], step[i])
            _next(rotation[i], step[i], qd[n, i], qdd[n, i], w, dw, acc)
            newton_euler(w, dw, acc, wrench)
            for j in range(i, -1, -1):
                _carry(rotation[j], step[j], wrench)
                for c in range(10):
                    out[n, j, 10 * i + c] = wrench[5, c]


@inlined
def _turn(q: float, alpha: float, rotation: FloatArray) -> None:
    """Rotation matrix from frame i to frame i − 1."""
    cq, sq, ca, sa = np.cos(q), np.sin(q), np.cos(alpha), np.sin(alpha)
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = cq, -sq * ca, sq * sa
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = sq, cq * ca, -cq * sa
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = 0.0, sa, ca


@inlined
def _place(d: float, a: float, alpha: float, step: FloatArray) -> None:
    """Vector from the origin of frame i − 1 to that of frame i, in frame i."""
    step[0], step[1], step[2] = a, d * np.sin(alpha), d * np.cos(alpha)


@inlined
def _next(
    r: FloatArray, p: FloatArray, qd: float, qdd: float, w: FloatArray, dw: FloatArray, acc: FloatArray
) -> None:
    """Propagate angular velocity, angular and linear acceleration from frame i − 1 to frame i, in place."""
    x, y, z = dw[0] + w[1] * qd, dw[1] - w[0] * qd, dw[2] + qdd
    u, v, s = w[0], w[1], w[2] + qd
    f, g, h = acc[0], acc[1], acc[2]
    for k in range(3):
        w[k] = r[0, k] * u + r[1, k] * v + r[2, k] * s
        dw[k] = r[0, k] * x + r[1, k] * y + r[2, k] * z
        acc[k] = r[0, k] * f + r[1, k] * g + r[2, k] * h
    dot = w[0] * p[0] + w[1] * p[1] + w[2] * p[2]
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    acc[0] += dw[1] * p[2] - dw[2] * p[1] + w[0] * dot - p[0] * square
    acc[1] += dw[2] * p[0] - dw[0] * p[2] + w[1] * dot - p[1] * square
    acc[2] += dw[0] * p[1] - dw[1] * p[0] + w[2] * dot - p[2] * square


@inlined
def newton_euler(w: FloatArray, dw: FloatArray, acc: FloatArray, wrench: FloatArray) -> None:
    """Force (rows 0–2) and moment about the frame's origin (rows 3–5) per inertial parameter."""
    wx, wy, wz = w[0], w[1], w[2]
    bx, by, bz = dw[0], dw[1], dw[2]
    wrench[:] = 0.0
    for k in range(3):
        wrench[k, 0] = acc[k]
    wrench[0, 1], wrench[0, 2], wrench[0, 3] = -wy * wy - wz * wz, wx * wy - bz, wx * wz + by
    wrench[1, 1], wrench[1, 2], wrench[1, 3] = wx * wy + bz, -wx * wx - wz * wz, wy * wz - bx
    wrench[2, 1], wrench[2, 2], wrench[2, 3] = wx * wz - by, wy * wz + bx, -wx * wx - wy * wy
    wrench[3, 2], wrench[3, 3] = acc[2], -acc[1]
    wrench[4, 1], wrench[4, 3] = -acc[2], acc[0]
    wrench[5, 1], wrench[5, 2] = acc[1], -acc[0]
    wrench[3, 4], wrench[3, 5], wrench[3, 6] = bx, -wy * wz, wy * wz
    wrench[4, 4], wrench[4, 5], wrench[4, 6] = wx * wz, by, -wx * wz
    wrench[5, 4], wrench[5, 5], wrench[5, 6] = -wx * wy, wx * wy, bz
    wrench[3, 7], wrench[3, 8], wrench[3, 9] = by - wx * wz, bz + wx * wy, wy * wy - wz * wz
    wrench[4, 7], wrench[4, 8], wrench[4, 9] = bx + wy * wz, wz * wz - wx * wx, bz - wx * wy
    wrench[5, 7], wrench[5, 8], wrench[5, 9] = wx * wx - wy * wy, bx - wy * wz, by + wx * wz


@inlined
def _carry(r: FloatArray, p: FloatArray, wrench: FloatArray) -> None:
    """Transform forces and moments from the origin of frame j to that of frame j − 1.

    Row 5 is then the moment about the z axis of frame j − 1, the axis of joint j.
    """
    for c in range(wrench.shape[1]):
        f, g, h = wrench[0, c], wrench[1, c], wrench[2, c]
        x = wrench[3, c] + p[1] * h - p[2] * g
        y = wrench[4, c] + p[2] * f - p[0] * h
        z = wrench[5, c] + p[0] * g - p[1] * f
        for k in range(3):
            wrench[k, c] = r[k, 0] * f + r[k, 1] * g + r[k, 2] * h
            wrench[3 + k, c] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z
