"""Parameter values of a model by name: those of the rig file, estimated ones, and zero for absent terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from labhil.physics import friction
from labhil.physics.bristles import bends_along
from labhil.physics.driven import SENSOR_LAG, apply_sensor_lag
from labhil.physics.extra_force import NO_FORCE, CompiledForce, ExtraForce
from labhil.physics.friction_law import GRID, laws
from labhil.physics.model import index_of
from labhil.physics.record import Record, Windows
from labhil.physics.terms import Parameter
from labhil.rig import RigFile
from labhil.signals import FloatArray


class Values:
    """Look up values by name: ``fixed`` values of the rig file first, then those of a vector theta."""

    def __init__(self, fixed: Mapping[str, float], parameters: Sequence[Parameter]) -> None:
        self.fixed = fixed
        self._index = index_of(parameters)
        self._laws = [law for law in laws() if law.coefficient in self._index]

    def __contains__(self, name: object) -> bool:
        return name in self.fixed or name in self._index

    def of(self, theta: FloatArray, name: str) -> float:
        """Value of ``name`` in ``theta``; zero, at which terms vanish, if there is no such parameter."""
        if name in self.fixed:
            return self.fixed[name]
        return float(theta[self._index[name]]) if name in self._index else 0.0

    def friction_law(self, theta: FloatArray, inertia: float) -> FloatArray:
        """Friction coefficients over the inertia, (12,), in the order of ``physics.friction``."""
        law = np.zeros(friction.SIZE)
        for place, name in friction.NAMES.items():
            law[place] = self.of(theta, name) / inertia
        for place, name in friction.NAMES_WITHOUT_INERTIA.items():
            law[place] = self.of(theta, name)
        if not law[list(friction.DRY)].any():
            law[friction.PRESLIDING_LENGTH] = 0.0
        return law

    def added_friction(self, theta: FloatArray, speeds: FloatArray) -> FloatArray:
        """User-defined friction (n,) at speeds (n,), in the unit of force."""
        total = np.zeros(len(speeds))
        for law in self._laws:
            total += law.force(speeds, lambda key: self.of(theta, key))
        return total

    def added_drag(self, theta: FloatArray, velocity: FloatArray) -> FloatArray:
        """User-defined friction (n,) against velocities (n,); zero where the part is at rest."""
        return np.asarray(np.sign(velocity) * self.added_friction(theta, np.abs(velocity)))

    def bends(self, theta: FloatArray, windows: Windows, x: FloatArray, v: FloatArray) -> FloatArray:
        """Share (N,) of dry friction that acts along a motion x, v (N,): sgn v where there is no bristle."""
        x, v = np.ascontiguousarray(x), np.ascontiguousarray(v)
        return bends_along(x, v, windows.owner, self.of(theta, "presliding_friction.length"))

    def additional_force(
        self, theta: FloatArray, inertia: float, extra: ExtraForce | None, record: Record
    ) -> tuple[CompiledForce, FloatArray] | None:
        """Combine user-defined friction and an additional force for a kernel.

        Args:
            theta: The parameter vector.
            inertia: Mass or inertia that forces are divided by.
            extra: The additional force, if any.
            record: The record.

        Returns:
            The force over the inertia, and its course (n,); None if there is neither.
        """
        added = any(self.of(theta, law.coefficient) for law in self._laws)
        if extra is None and not added:
            return None
        table = self.added_friction(theta, GRID) / inertia if added else np.empty(0)
        return (extra or NO_FORCE).over(inertia, record, table)

    def apply_sensor(self, theta: FloatArray, record: Record, windows: Windows, x: FloatArray) -> FloatArray:
        """Apply nonlinearity, gain error, offset and lag of the sensor to an output (N,)."""
        cubic, gain = self.of(theta, "sensor_nonlinearity.cubic"), self.of(theta, "sensor_gain.gain")
        x = x + cubic * x * x * x if cubic else x
        x = x * (1.0 + gain) if gain else x
        x = x + self.of(theta, "sensor_offset.offset")
        time_constant = self.of(theta, SENSOR_LAG)
        return apply_sensor_lag(record, windows, x, time_constant) if time_constant else x


def horizon_of(stated: float | None, typical: float, record: Record | None) -> float:
    """Scored horizon, s: the stated one, else ``typical``, limited by the length of the recordings."""
    if stated or record is None:
        return stated or typical
    return min(typical, record.max_horizon)


def limit_horizon(horizon: float, typical: float) -> float:
    """Limit a horizon (s) to a factor of 5 around a typical one, so that a bad fit does not choose it."""
    return float(np.clip(horizon, 0.2 * typical, 5.0 * typical))


def known_numbers(rig: RigFile) -> dict[str, float]:
    """Single numbers that the rig file states under [known], by name."""
    return {name: value for name in rig.kind.known if (value := rig.known_number(name)) is not None}
