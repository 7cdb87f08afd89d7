"""What a model looks up again and again for one record: regressors and columns of joint laws at its rows."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

import numpy as np
from scipy import interpolate

from labhil.kinds import JOINTS
from labhil.physics.arm.joint_laws import LAWS, JointMotion, Law, directions
from labhil.physics.arm.links import Links
from labhil.physics.arm.motion import Motion
from labhil.physics.arm.rigid_body import regressor
from labhil.signals import FloatArray

REMEMBERED = 40 * JOINTS

Value = TypeVar("Value")


class Remembered(Generic[Value]):
    """The last few results of something that takes long; several threads may ask."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._known: dict[Hashable, Value] = {}
        self._lock = Lock()

    def of(self, key: Hashable, made: Callable[[], Value]) -> Value:
        """What is known under ``key``, or what ``made`` makes."""
        found = self._known.get(key)
        if found is None:
            found = made()
            with self._lock:
                if len(self._known) >= self._size:
                    self._known.pop(next(iter(self._known)))
                self._known[key] = found
        return found

    def forget(self, key: Hashable) -> None:
        """Make it anew the next time."""
        with self._lock:
            self._known.pop(key, None)


class View:
    """One motion seen at rows that stand ``delay`` s before the places ``rows`` (n,) of its raster.

    ``reference`` (6,) °C are the temperatures at which viscous friction is stated.
    """

    def __init__(
        self, links: Links, motion: Motion, rows: np.ndarray, reference: FloatArray, delay: float = 0.0
    ) -> None:
        self.links = links
        self.motion = motion
        self.rows = rows
        self._reference = reference
        self._delay = delay
        self._laws: Remembered[FloatArray] = Remembered(REMEMBERED)
        self._loads: Remembered[FloatArray] = Remembered(4 * JOINTS)
        self._regressors: Remembered[FloatArray] = Remembered(4)
        self._bent: Remembered[FloatArray] = Remembered(4)
        self._full: Remembered[FloatArray] = Remembered(2)

    def at_rows(self, columns: FloatArray) -> FloatArray:
        """Columns (m, …) of the whole motion at the rows, (n, …)."""
        if self._delay == 0.0:
            return np.ascontiguousarray(columns[self.rows])
        t = self.motion.t
        spline = interpolate.make_interp_spline(t, columns, k=3)
        return np.asarray(spline(np.clip(t[self.rows] - self._delay, t[0], t[-1])))

    def rigid(self, gravity: FloatArray) -> FloatArray:
        """Regressor (n, 6, 60) of the rigid body, torque per inertial parameter."""
        return self._regressors.of(gravity.tobytes(), lambda: self._regressor(gravity))

    def _regressor(self, gravity: FloatArray) -> FloatArray:
        m = self.motion
        q, qd, qdd = self.at_rows(m.q), self.at_rows(m.qd), self.at_rows(m.qdd)
        return regressor(self.links, q, qd, qdd, gravity)

    def law(self, joint: int, name: str, shape: float, length: float) -> FloatArray:
        """Torque (n,) per unit of one linear parameter of a joint; ``length`` rad of its bristles."""
        law = LAWS[name]
        key = (joint, name, shape if law.shaped_by else 0.0, length if law.dry else 0.0)
        return self._laws.of(key, lambda: self._column(law, joint, shape, length))

    def _column(self, law: Law, joint: int, shape: float, length: float) -> FloatArray:
        m = self.motion
        s = self._direction(joint, length) if law.dry else m.qd[:, joint]
        warmer = m.temperature[:, joint] - self._reference[joint]
        column = law.column(JointMotion(m.q[:, joint], m.qd[:, joint], m.qdd[:, joint], warmer, s, shape))
        return self.at_rows(m.filtered(column))

    def _direction(self, joint: int, length: float) -> FloatArray:
        return directions(self.motion.q[:, joint], self.motion.qd[:, joint], length)

    def load(self, joint: int, length: float, inertial: FloatArray, gravity: FloatArray) -> FloatArray:
        """|τ_load|·s of one joint (n,): the rigid body's torque along the direction of dry friction."""
        key = (joint, length, inertial.tobytes(), gravity.tobytes())
        return self._loads.of(key, lambda: self._load(joint, length, inertial, gravity))

    def _load(self, joint: int, length: float, inertial: FloatArray, gravity: FloatArray) -> FloatArray:
        torque = self._whole(inertial, gravity)[:, joint]
        return self.at_rows(self.motion.filtered(np.abs(torque) * self._direction(joint, length)))

    def bent(self, compliance: FloatArray, inertial: FloatArray, gravity: FloatArray) -> FloatArray:
        """Regressor (n, 6, 60) where links hang ``compliance`` (6,) rad/(N·m) times their load behind."""
        key = (compliance.tobytes(), inertial.tobytes(), gravity.tobytes())
        return self._bent.of(key, lambda: self._bend(compliance, inertial, gravity))

    def _bend(self, compliance: FloatArray, inertial: FloatArray, gravity: FloatArray) -> FloatArray:
        m = self.motion
        behind = compliance * self._whole(inertial, gravity)
        slower = np.gradient(behind, m.t, axis=0)
        slope = np.gradient(slower, m.t, axis=0)
        q, qd = self.at_rows(m.q - behind), self.at_rows(m.qd - slower)
        return regressor(self.links, q, qd, self.at_rows(m.qdd - slope), gravity)

    def _whole(self, inertial: FloatArray, gravity: FloatArray) -> FloatArray:
        """Rigid torques (m, 6) of the whole motion."""
        m = self.motion
        y = self._full.of(gravity.tobytes(), lambda: regressor(self.links, m.q, m.qd, m.qdd, gravity))
        return np.asarray(y @ inertial)
