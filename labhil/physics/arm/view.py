"""Caches of regressors and of columns of joint laws at the rows of a record."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

import numpy as np

from labhil.kinds import JOINTS
from labhil.physics.arm.chain import Chain
from labhil.physics.arm.joint_laws import JointMotion, Law, directions
from labhil.physics.arm.motion import Motion, PreparedRecord, unfiltered_motion
from labhil.physics.extra_force import CurveArgument, ExtraForce, along_positive
from labhil.physics.record import Record
from labhil.signals import FloatArray

LAW_CACHE_SIZE = 15 * JOINTS
"""Columns of joint laws that are kept: 15 for each joint."""

FORCE_CACHE_SIZE = 2 * JOINTS
"""Columns of additional forces that are kept: 2 for each joint."""

INTERPOLATION_POINTS = 6
"""Samples of an interpolating polynomial."""

Value = TypeVar("Value")


class Cache(Generic[Value]):
    """The last ``size`` results of an expensive computation; thread-safe."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._known: dict[Hashable, Value] = {}
        self._lock = Lock()

    def of(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the result under ``key``; compute it by ``make`` if it is not cached."""
        value = self._known.get(key)
        if value is None:
            value = make()
            with self._lock:
                if len(self._known) >= self._size:
                    self._known.pop(next(iter(self._known)))
                self._known[key] = value
        return value

    def forget(self, key: Hashable) -> None:
        """Remove the result under ``key``."""
        with self._lock:
            self._known.pop(key, None)


class RecordViews:
    """Cache of motions and views of the last ``size`` records; ``reference`` as in :class:`View`."""

    def __init__(self, reference: FloatArray, size: int) -> None:
        self._reference = reference
        self._motions: Cache[tuple[FloatArray, Motion, np.ndarray]] = Cache(size)
        self._views: Cache[View] = Cache(size)

    def motion(self, record: Record) -> tuple[FloatArray, Motion, np.ndarray]:
        """The inputs of a record, their motion, and the positions of the record's rows in it."""
        # records of the same inputs share their motion: a bootstrap replaces outputs only
        key = id(record.inputs)
        entry = self._motions.of(key, lambda: _motion_of(record))
        if entry[0] is not record.inputs:
            self._motions.forget(key)
            entry = self._motions.of(key, lambda: _motion_of(record))
        return entry

    def of(self, links: Chain, record: Record) -> View:
        """The view of the motion of a record for these rigid bodies."""
        inputs, motion, rows = self.motion(record)
        view = self._views.of(id(inputs), lambda: View(links, motion, rows, self._reference))
        if view.rows is not rows:
            self._views.forget(id(inputs))
            return self.of(links, record)
        return view


def _motion_of(record: Record) -> tuple[FloatArray, Motion, np.ndarray]:
    """Inputs, motion and row positions of a record, prepared or not."""
    if isinstance(record, PreparedRecord) and record.motion is not None:
        return record.inputs, record.motion, record.places
    return record.inputs, unfiltered_motion(record), np.arange(len(record))


class LagrangeInterpolation:
    """Lagrange interpolation at places (n,) between m evenly spaced samples.

    With six points, a sine of ten samples per period is interpolated within 0.03 %.
    """

    def __init__(self, places: FloatArray, m: int) -> None:
        first = np.clip(np.floor(places).astype(np.int64) - 2, 0, m - INTERPOLATION_POINTS)
        x = places - first
        self._near = first[:, None] + np.arange(INTERPOLATION_POINTS)
        self._weights = np.ones((len(places), INTERPOLATION_POINTS))
        for i in range(INTERPOLATION_POINTS):
            for j in range(INTERPOLATION_POINTS):
                if j != i:
                    self._weights[:, i] *= (x - j) / (i - j)

    def read(self, columns: FloatArray) -> FloatArray:
        """Interpolate columns (m, …) at the places, (n, …)."""
        return np.asarray(np.einsum("ni,ni...->n...", self._weights, columns[self._near]))


class View:
    """Torques of one motion at the rows (n,) of a record, or ``delay`` seconds before them, cached.

    ``reference`` (6,), °C, are the temperatures at which viscous friction has its stated value.
    """

    def __init__(self, links: Chain, motion: Motion, rows: np.ndarray, reference: FloatArray) -> None:
        self.links = links
        self.motion = motion
        self.rows = rows
        self.torques: Cache[FloatArray] = Cache(8)
        self._reference = reference
        self._between: Cache[LagrangeInterpolation] = Cache(4)
        self._laws: Cache[FloatArray] = Cache(LAW_CACHE_SIZE)
        self._whole_laws: Cache[FloatArray] = Cache(LAW_CACHE_SIZE)
        self._regressors: Cache[FloatArray] = Cache(4)
        self._elastic: Cache[FloatArray] = Cache(4)
        self._loads: Cache[FloatArray] = Cache(4)
        self._pushed: Cache[FloatArray] = Cache(FORCE_CACHE_SIZE)

    def at_rows(self, columns: FloatArray, delay: float) -> FloatArray:
        """Interpolate columns (m, …) of the motion at the rows, (n, …)."""
        if delay == 0.0:
            return np.ascontiguousarray(columns[self.rows])
        return self._between.of(delay, lambda: self._delayed_places(delay, len(columns))).read(columns)

    def _delayed_places(self, delay: float, m: int) -> LagrangeInterpolation:
        return LagrangeInterpolation(np.clip(self.rows - delay / self.motion.period, 0.0, m - 1.0), m)

    def rigid(self, gravity: FloatArray, delay: float) -> FloatArray:
        """Regressor of the rigid body, torque per inertial parameter, (n, 6, 60)."""

        def compute() -> FloatArray:
            m = self.motion
            return self.links.regressor(*self._at((m.q, m.qd, m.qdd), delay), gravity)

        return self._regressors.of((gravity.tobytes(), delay), compute)

    def straight_torques(self, gravity: FloatArray, delay: float, inertial: FloatArray) -> FloatArray:
        """Torques (n, 6), N·m, of the rigid body with stiff joints at inertial parameters (60,)."""
        m = self.motion
        return self.links.torques(*self._at((m.q, m.qd, m.qdd), delay), gravity, inertial)

    def _at(
        self, motion: tuple[FloatArray, FloatArray, FloatArray], delay: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        q, qd, qdd = (self.at_rows(x, delay) for x in motion)
        return q, qd, qdd

    def law(self, joint: int, name: str, law: Law, shape: float, length: float, delay: float) -> FloatArray:
        """Torque (n,) per unit of a linear parameter of a joint; ``length`` is the presliding length, rad."""
        key = (joint, name, shape if law.shaped_by else 0.0, length if law.dry else 0.0)

        def compute() -> FloatArray:
            full_rate = self._whole_laws.of(key, lambda: self._column(law, joint, shape, length))
            return self.at_rows(full_rate, delay)

        return self._laws.of((*key, delay), compute)

    def _column(self, law: Law, joint: int, shape: float, length: float) -> FloatArray:
        m = self.motion
        s = self._direction(joint, length) if law.dry else m.qd[:, joint]
        warmer = m.temperature[:, joint] - self._reference[joint]
        return m.filtered(
            law.column(JointMotion(m.q[:, joint], m.qd[:, joint], m.qdd[:, joint], warmer, s, shape))
        )

    def _direction(self, joint: int, length: float) -> FloatArray:
        return directions(self.motion.q[:, joint], self.motion.qd[:, joint], length)

    def push(self, force: ExtraForce, length: float, delay: float) -> FloatArray:
        """Torque (n,), N·m, of an additional force on its joint; ``length`` is the presliding length, rad."""
        grid, values = force.grid.tobytes(), force.values.tobytes()
        key = (force.joint, force.of, force.acts, grid, values, length, delay)
        return self._pushed.of(
            key, lambda: self.at_rows(self.motion.filtered(self._force(force, length)), delay)
        )

    def _force(self, force: ExtraForce, length: float) -> FloatArray:
        """Torque of an additional force along the whole motion, (m,)."""
        assert force.joint is not None
        m, (name, _, number) = self.motion, force.of.rpartition("_")
        along = (m.q if name == "actual_q" else m.qd)[:, int(number)]
        places = np.abs(along) if force.acts is CurveArgument.SPEED_AGAINST else along
        curve = np.interp(places, force.grid, force.values)
        return along_positive(force.acts, curve, m.qd[:, force.joint], self._direction(force.joint, length))

    def load(
        self, joint: int, length: float, inertial: FloatArray, gravity: FloatArray, delay: float
    ) -> FloatArray:
        """|τ_load|·s of one joint (n,), N·m: rigid-body torque along the direction s of dry friction."""
        key = (joint, length, inertial.tobytes(), gravity.tobytes())

        def compute() -> FloatArray:
            torque = np.abs(self._whole(inertial, gravity)[:, joint])
            full_rate = self._whole_laws.of(
                key, lambda: self.motion.filtered(torque * self._direction(joint, length))
            )
            return self.at_rows(full_rate, delay)

        return self._laws.of((*key, delay), compute)

    def elastic_regressor(
        self, compliance: FloatArray, inertial: FloatArray, gravity: FloatArray, delay: float
    ) -> FloatArray:
        """Regressor (n, 6, 60) with elastic joints: links lag by ``compliance`` (6,) rad/(N·m) times load."""

        def compute() -> FloatArray:
            return self.links.regressor(*self._elastic_motion(compliance, inertial, gravity, delay), gravity)

        return self._elastic.of((compliance.tobytes(), inertial.tobytes(), gravity.tobytes(), delay), compute)

    def elastic_torques(
        self,
        compliance: FloatArray,
        loading: FloatArray,
        gravity: FloatArray,
        delay: float,
        inertial: FloatArray,
    ) -> FloatArray:
        """Torques (n, 6) with elastic joints at ``inertial`` (60,); ``loading`` (60,) gives the load."""
        motion = self._elastic_motion(compliance, loading, gravity, delay)
        return self.links.torques(*motion, gravity, inertial)

    def _elastic_motion(
        self, compliance: FloatArray, inertial: FloatArray, gravity: FloatArray, delay: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Motion of the links behind elastic joints at the rows."""
        m = self.motion
        behind = m.slowly(compliance * self._whole(inertial, gravity))
        slower = np.gradient(behind, m.t, axis=0)
        slope = np.gradient(slower, m.t, axis=0)
        return self._at((m.q - behind, m.qd - slower, m.qdd - slope), delay)

    def _whole(self, inertial: FloatArray, gravity: FloatArray) -> FloatArray:
        """Rigid-body torques (m, 6) of the whole motion."""

        def compute() -> FloatArray:
            m = self.motion
            return self.links.torques(m.q, m.qd, m.qdd, gravity, inertial)

        return self._loads.of((inertial.tobytes(), gravity.tobytes()), compute)
