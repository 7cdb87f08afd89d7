"""Elastic joints: the drive follows the servo, and the link follows the drive through a spring.

M(q)·q̈ + C(q, q̇)·q̇ + G(q) = K·(θ − q) + D·(θ̇ − q̇) with the drive's angle θ; the torque on the right is
the torque of the drive. A step is implicit at a share of itself: at the middle for springs that are slow
compared with the step, at the end for fast ones, which so come to rest. The implicit part of the springs is
an addition to the inertia.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from labhil.plants.arm.effects import Values
from labhil.plants.arm.links import JOINTS
from labhil.plants.arm.newton_euler import RecursiveBody
from labhil.plants.arm.rigid_body import RigidBody
from labhil.plants.arm.servo import Motion, cubic, cubic_slope
from labhil.signals import FloatArray

MAX_STEP = 2e-3
"""s; against steps of 0.05 ms that costs 1 mN·m (RMS) at the default compliances, 6 at 1/200 of them."""
MIN_COMPLIANCE = 1e-7
"""rad/(N·m), of the joints without elasticity in an arm with some; they need no damping."""
SETTLING_ITERATIONS = 20


@dataclass(frozen=True, slots=True)
class Springs:
    """Stiffness N·m/rad and damping N·m·s/rad of the joints, (6,) each."""

    stiffness: FloatArray
    damping: FloatArray

    @classmethod
    def of(cls, values: Values) -> Springs | None:
        """Take them from the parameters of a plant; None where all joints are rigid."""
        compliance = values.per_joint("joint_elasticity.compliance")
        if not np.any(compliance > 0.0):
            return None
        stiffness = 1.0 / np.maximum(compliance, MIN_COMPLIANCE)
        relaxation = values.per_joint("joint_elasticity.relaxation")
        return cls(stiffness, np.where(compliance > 0.0, stiffness * relaxation, 0.0))


class ElasticBody:
    """The links on their springs; they start in the equilibrium of :meth:`settle`."""

    def __init__(self, body: RigidBody | RecursiveBody, springs: Springs) -> None:
        self._body = body
        self._springs = springs
        self._drive = np.zeros((2, JOINTS))
        self._link = np.zeros((2, JOINTS))
        self._torque = np.zeros(JOINTS)
        self._inertia = np.ones(JOINTS)

    def settle(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> None:
        """Set the links to their equilibrium while the drives move with these values, (6,) each."""
        self._body.set_armature(np.zeros(JOINTS))
        link = q.copy()
        for _ in range(SETTLING_ITERATIONS):
            torque = self._body.torques(link[None], qd[None], qdd[None])[0]
            link = q - torque / self._springs.stiffness
        self._drive[:] = q, qd
        self._link[:] = link, qd
        self._torque = self._springs.stiffness * (q - link)
        zeros = np.zeros((JOINTS, JOINTS))
        weight = self._body.torques(link[None], zeros[:1], zeros[:1])
        masses = self._body.torques(np.tile(link, (JOINTS, 1)), zeros, np.eye(JOINTS)) - weight
        self._inertia = np.diag(masses).copy()

    def torques(self, motion: Motion, h: FloatArray) -> FloatArray:
        """Return the drives' torques (n, 6) N·m; row i comes ``h[i]`` s after the one before."""
        out = np.empty_like(motion.q)
        for i in range(len(h)):
            steps = max(1, math.ceil(h[i] / MAX_STEP - 1e-9)) if h[i] > 0.0 else 0
            out[i] = self._advance(motion.q[i], motion.qd[i], h[i], steps)
        return out

    def _advance(self, q: FloatArray, qd: FloatArray, h: float, steps: int) -> FloatArray:
        """Advance by ``steps`` steps while the drives move to q and q̇ within h (s); return the torques.

        They are extrapolated to the end of the last step from those of the last two steps.
        """
        final = self._torque
        if steps:
            k, d, step = self._springs.stiffness, self._springs.damping, h / steps
            share = self._implicit_shares(step)
            implicit_inertia = share * step * (d + share * step * k)
            self._body.set_armature(implicit_inertia)
            moments = (np.arange(steps, dtype=np.float64)[:, None] + share) * step
            span = np.array([[h]])
            angles = cubic(self._drive[0], self._drive[1], q, qd, moments, span)
            rates = cubic_slope(self._drive[0], self._drive[1], q, qd, moments, span)
            for angle, rate in zip(angles, rates, strict=True):
                angle_now, rate_now = self._link
                predicted = angle_now + share * step * rate_now
                spring_torque = k * (angle - predicted) + d * (rate - rate_now)
                gain = step * self._body.accelerations(predicted, rate_now, spring_torque)
                torque = spring_torque - implicit_inertia * gain / step
                final = torque + (1.0 - share) * (torque - self._torque)
                self._link[0] += step * (rate_now + share * gain)
                self._link[1] += gain
                self._torque = torque
        self._drive[:] = q, qd
        return final

    def _implicit_shares(self, step: float) -> FloatArray:
        """Return the implicit share of a step of each spring (6,): from one half, slow, to one, fast."""
        relative_stiffness = self._springs.stiffness / self._inertia * step**2
        return np.asarray(0.5 + 0.5 * relative_stiffness / (1.0 + relative_stiffness))
