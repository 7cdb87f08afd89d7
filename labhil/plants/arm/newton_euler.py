"""The rigid body of the arm by the recursive Newton-Euler algorithm, compiled, without a physics engine.

One evaluation takes a few µs. It agrees with :mod:`labhil.plants.arm.rigid_body` to rounding (see its tests).
Outward from the base: velocities and accelerations; inward from the tool: forces and moments, in the frame of
each link.
"""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.errors import UsageError
from labhil.plants.arm.links import JOINTS, Links, Vector
from labhil.plants.arm.rigid_body import Load
from labhil.signals import FloatArray


class LinkArrays(NamedTuple):
    """The links as arrays: m, and cosines and sines of the twists (6,); kg; m (6, 3); kg·m² (6, 3, 3).

    ``gravity`` (3,) m/s² in the base's frame.
    """

    a: FloatArray
    d: FloatArray
    cosine: FloatArray
    sine: FloatArray
    mass: FloatArray
    centre: FloatArray
    inertia: FloatArray
    gravity: FloatArray

    @classmethod
    def of(cls, links: Links, load: Load) -> LinkArrays:
        """Make the arrays; the payload becomes part of the last link.

        Raises:
            UsageError: The load has a cable, which needs the physics engine.
        """
        if load.cable_stiffness != 0.0:
            raise UsageError("hidden_cable is not among the effects of an arm in real time")
        parts = links.links
        table = cls(
            a=np.array([link.a for link in parts]),
            d=np.array([link.d for link in parts]),
            cosine=np.array([cos(link.alpha) for link in parts]),
            sine=np.array([sin(link.alpha) for link in parts]),
            mass=np.array([link.mass for link in parts]),
            centre=np.array([link.centre for link in parts]),
            inertia=np.array([_matrix(link.inertia) for link in parts]),
            gravity=np.array(load.gravity()),
        )
        table.add_point_mass(load.mass, load.centre)
        return table

    def add_point_mass(self, mass: float, centre: Vector) -> None:
        """Add a point mass (kg) in the flange's frame (m) to the last link."""
        if mass == 0.0:
            return
        link_mass, link_centre = self.mass[-1], self.centre[-1].copy()
        centre_of_both = (link_mass * link_centre + mass * np.array(centre)) / (link_mass + mass)
        self.inertia[-1] += link_mass * _point_inertia(link_centre - centre_of_both) + mass * _point_inertia(
            np.array(centre) - centre_of_both
        )
        self.mass[-1] += mass
        self.centre[-1] = centre_of_both


def _matrix(inertia: tuple[float, float, float, float, float, float]) -> FloatArray:
    xx, yy, zz, xy, xz, yz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _point_inertia(r: FloatArray) -> FloatArray:
    """Moment of inertia (3, 3) of a point of 1 kg at r about the origin."""
    return np.asarray(float(r @ r) * np.eye(3) - np.outer(r, r))


class RecursiveBody:
    """Rigid links with one hinge each; the interface of :class:`~labhil.plants.arm.rigid_body.RigidBody`."""

    def __init__(self, links: Links, load: Load | None = None) -> None:
        self.table = LinkArrays.of(links, load or Load())
        self._armature = np.zeros(JOINTS)
        self._out = np.zeros(JOINTS)
        self._masses = np.zeros((JOINTS, JOINTS))

    def torques(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Return the joint torques (n, 6) N·m of a motion (n, 6): M(q)·q̈ + C(q, q̇)·q̇ + G(q), eq. 4.52."""
        out = np.empty((len(q), JOINTS))
        for i in range(len(q)):
            recursion(self.table, q[i], qd[i], qdd[i], out[i])
        return out + self._armature * qdd

    def torque(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Return the joint torques (6,) N·m at one instant, without armature."""
        out = np.empty(JOINTS)
        recursion(self.table, q, qd, qdd, out)
        return out

    def accelerations(self, q: FloatArray, qd: FloatArray, torque: FloatArray) -> FloatArray:
        """Return the joint accelerations (6,) rad/s² under joint torques (6,) N·m, armature included."""
        zeros = np.zeros(JOINTS)
        recursion(self.table, q, qd, zeros, self._out)
        masses = self.mass_matrix(q) + np.diag(self._armature)
        return np.asarray(np.linalg.solve(masses, torque - self._out))

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Return M(q) (6, 6), kg·m², without armature."""
        mass_matrix(self.table, q, self._masses)
        return self._masses.copy()

    def set_armature(self, armature: FloatArray) -> None:
        """Add to the diagonal of M in :meth:`accelerations` and :meth:`torques`, (6,) kg·m²."""
        self._armature = armature.copy()


@compiled
def recursion(table: LinkArrays, q: FloatArray, qd: FloatArray, qdd: FloatArray, out: FloatArray) -> None:
    """Write the joint torques (6,) N·m at one instant: rad, rad/s, rad/s²."""
    rotations = np.zeros((7, 3, 3))
    forces, moments = np.zeros((6, 3)), np.zeros((6, 3))
    arms = np.zeros((6, 3))
    w, dw, dv = np.zeros(3), np.zeros(3), -table.gravity
    axis = np.array([0.0, 0.0, 1.0])
    for i in range(6):
        c, s, ca, sa = np.cos(q[i]), np.sin(q[i]), table.cosine[i], table.sine[i]
        rotation = rotations[i]
        rotation[0, 0], rotation[0, 1], rotation[0, 2] = c, -s * ca, s * sa
        rotation[1, 0], rotation[1, 1], rotation[1, 2] = s, c * ca, -c * sa
        rotation[2, 0], rotation[2, 1], rotation[2, 2] = 0.0, sa, ca
        arms[i, 0], arms[i, 1], arms[i, 2] = table.a[i], table.d[i] * sa, table.d[i] * ca
        dw = rotate_back(rotation, dw + axis * qdd[i] + cross(w, axis * qd[i]))
        w = rotate_back(rotation, w + axis * qd[i])
        dv = rotate_back(rotation, dv) + cross(dw, arms[i]) + cross(w, cross(w, arms[i]))
        centre = table.centre[i]
        forces[i] = table.mass[i] * (dv + cross(dw, centre) + cross(w, cross(w, centre)))
        moments[i] = rotate(table.inertia[i], dw) + cross(w, rotate(table.inertia[i], w))
    rotations[6, 0, 0] = rotations[6, 1, 1] = rotations[6, 2, 2] = 1.0
    force, moment = np.zeros(3), np.zeros(3)
    for i in range(5, -1, -1):
        carried = rotate(rotations[i + 1], force)
        moment = (
            rotate(rotations[i + 1], moment)
            + cross(arms[i], carried)
            + cross(arms[i] + table.centre[i], forces[i])
            + moments[i]
        )
        force = carried + forces[i]
        out[i] = moment[1] * table.sine[i] + moment[2] * table.cosine[i]


@compiled
def mass_matrix(table: LinkArrays, q: FloatArray, out: FloatArray) -> None:
    """Write M(q) (6, 6) kg·m²: the torques of a unit acceleration of each joint, without gravity."""
    weight, column, zeros = np.zeros(6), np.zeros(6), np.zeros(6)
    recursion(table, q, zeros, zeros, weight)
    for i in range(6):
        unit = np.zeros(6)
        unit[i] = 1.0
        recursion(table, q, zeros, unit, column)
        out[:, i] = column - weight


@compiled
def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b, (3,)."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@compiled
def rotate(rotation: FloatArray, v: FloatArray) -> FloatArray:
    """Return turn·v, (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = rotation[i, 0] * v[0] + rotation[i, 1] * v[1] + rotation[i, 2] * v[2]
    return out


@compiled
def rotate_back(rotation: FloatArray, v: FloatArray) -> FloatArray:
    """Return turnᵀ·v, (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = rotation[0, i] * v[0] + rotation[1, i] * v[1] + rotation[2, i] * v[2]
    return out
