"""Poses in the controller's format: x, y, z in m and a rotation vector in rad; rotation matrices by rows."""

from __future__ import annotations

from math import acos, atan2, cos, pi, sin, sqrt

Pose = tuple[float, float, float, float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]
Point = tuple[float, float, float]

NO_ROTATION: Rotation = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
NO_OFFSET: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def rotation_of(x: float, y: float, z: float) -> Rotation:
    """Return the rotation by |v| rad about v = (x, y, z) (Rodrigues' formula)."""
    angle = sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return (1.0, -z, y, z, 1.0, -x, -y, x, 1.0)
    x, y, z = x / angle, y / angle, z / angle
    c, s = cos(angle), sin(angle)
    v = 1.0 - c
    return (
        c + x * x * v, x * y * v - z * s, x * z * v + y * s,
        y * x * v + z * s, c + y * y * v, y * z * v - x * s,
        z * x * v - y * s, z * y * v + x * s, c + z * z * v,
    )  # fmt: skip


def vector_of(r: Rotation) -> Point:
    """Return the rotation vector of a rotation, its angle from 0 to π."""
    x, y, z = r[7] - r[5], r[2] - r[6], r[3] - r[1]
    twice_sine = sqrt(x * x + y * y + z * z)
    angle = atan2(twice_sine, r[0] + r[4] + r[8] - 1.0)
    if twice_sine > 1e-6:
        share = angle / twice_sine
        return (x * share, y * share, z * share)
    if angle < 1.0:
        return (0.5 * x, 0.5 * y, 0.5 * z)
    return _half_turn(r, angle)


def _half_turn(r: Rotation, angle: float) -> Point:
    """Rotation vector of a rotation by about π, from the largest element of its diagonal."""
    diagonal = (r[0], r[4], r[8])
    largest = max(range(3), key=diagonal.__getitem__)
    column = [
        r[largest] + r[3 * largest],
        r[largest + 3] + r[3 * largest + 1],
        r[largest + 6] + r[3 * largest + 2],
    ]
    column[largest] = 2.0 * diagonal[largest] + 1.0 - sum(diagonal)
    norm = sqrt(sum(value * value for value in column)) or 1.0
    return (column[0] / norm * angle, column[1] / norm * angle, column[2] / norm * angle)


def times(a: Rotation, b: Rotation) -> Rotation:
    """Return the product a·b."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


def transpose(r: Rotation) -> Rotation:
    """Return the inverse rotation."""
    return (r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8])


def rotate(r: Rotation, p: Point) -> Point:
    """Return r·p."""
    return (
        r[0] * p[0] + r[1] * p[1] + r[2] * p[2],
        r[3] * p[0] + r[4] * p[1] + r[5] * p[2],
        r[6] * p[0] + r[7] * p[1] + r[8] * p[2],
    )


def pose_times(a: Pose, b: Pose) -> Pose:
    """Return the pose b, given relative to a, in the frame of a (URScript's ``pose_trans``)."""
    rotation = rotation_of(*a[3:])
    x, y, z = rotate(rotation, b[:3])
    turn = times(rotation, rotation_of(*b[3:]))
    return (a[0] + x, a[1] + y, a[2] + z, *vector_of(turn))


def inverse(a: Pose) -> Pose:
    """Return the inverse pose."""
    back = transpose(rotation_of(*a[3:]))
    x, y, z = rotate(back, a[:3])
    return (-x, -y, -z, -a[3], -a[4], -a[5])


def angle_between(a: Rotation, b: Rotation) -> float:
    """Return the angle (rad) of the rotation from a to b."""
    r = times(transpose(a), b)
    return acos(min(max(0.5 * (r[0] + r[4] + r[8] - 1.0), -1.0), 1.0)) if a != b else 0.0


def nearest_turn(angle: float, near: float, limit: float) -> float:
    """Return the angle plus the multiple of 2π that is nearest to ``near`` within ±limit."""
    angle += 2.0 * pi * round((near - angle) / (2.0 * pi))
    while angle > limit:
        angle -= 2.0 * pi
    while angle < -limit:
        angle += 2.0 * pi
    return angle
