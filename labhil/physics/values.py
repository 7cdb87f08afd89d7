"""A model's numbers by name: what the rig file knows, what is estimated, zero for what is not there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from labhil.physics import friction
from labhil.physics.driven import lagged
from labhil.physics.extra_force import NO_FORCE, CompiledForce, ExtraForce
from labhil.physics.friction_law import GRID, laws
from labhil.physics.model import Record, Windows, index_of
from labhil.physics.terms import Parameter
from labhil.rig import RigFile
from labhil.signals import FloatArray


class Values:
    """Looks numbers up: ``fixed`` ones of the rig file first, then those of a vector by its parameters."""

    def __init__(self, fixed: Mapping[str, float], parameters: Sequence[Parameter]) -> None:
        self.fixed = fixed
        self._index = index_of(parameters)
        self._laws = [law for law in laws() if law.coefficient in self._index]

    def __contains__(self, name: object) -> bool:
        return name in self.fixed or name in self._index

    def of(self, theta: FloatArray, name: str) -> float:
        """The value of ``name`` in ``theta``; zero, which is neutral, where no such parameter is."""
        if name in self.fixed:
            return self.fixed[name]
        return float(theta[self._index[name]]) if name in self._index else 0.0

    def friction_law(self, theta: FloatArray, inertia: float) -> FloatArray:
        """Strengths of all friction laws over the inertia, in the order of ``physics.friction``."""
        law = np.zeros(friction.SIZE)
        for place, name in friction.NAMES.items():
            law[place] = self.of(theta, name) / inertia
        for place, name in friction.PURE.items():
            law[place] = self.of(theta, name)
        return law

    def added_friction(self, theta: FloatArray, speeds: FloatArray) -> FloatArray:
        """Friction (n,) of laws of one's own at speeds (n,), in the unit of force."""
        total = np.zeros(len(speeds))
        for law in self._laws:
            total += law.force(speeds, lambda key: self.of(theta, key))
        return total

    def added_drag(self, theta: FloatArray, velocity: FloatArray) -> FloatArray:
        """The same (n,) against velocities (n,); zero where the part rests."""
        return np.asarray(np.sign(velocity) * self.added_friction(theta, np.abs(velocity)))

    def beside(
        self, theta: FloatArray, inertia: float, extra: ExtraForce | None, record: Record
    ) -> tuple[CompiledForce, FloatArray] | None:
        """What acts beside a kernel's own laws, as it takes it: laws of one's own, and one more force.

        None where nothing does.
        """
        added = any(self.of(theta, law.coefficient) for law in self._laws)
        if extra is None and not added:
            return None
        table = self.added_friction(theta, GRID) / inertia if added else np.empty(0)
        return (extra or NO_FORCE).over(inertia, record, table)

    def sensed(self, theta: FloatArray, record: Record, windows: Windows, x: FloatArray) -> FloatArray:
        """What a sensor with nonlinearity, gain error, offset and lag makes of an output (N,)."""
        cubic, gain = self.of(theta, "sensor_nonlinearity.cubic"), self.of(theta, "sensor_gain.gain")
        x = x + cubic * x * x * x if cubic else x
        x = x * (1.0 + gain) if gain else x
        x = x + self.of(theta, "sensor_offset.offset")
        time_constant = self.of(theta, "sensor_lag.time_constant")
        return lagged(record, windows, x, time_constant) if time_constant else x


def horizon_of(stated: float | None, typical: float, record: Record | None) -> float:
    """The stated horizon, or a typical one (s), at most so long that two fit into every recording."""
    if stated or record is None:
        return stated or typical
    return min(typical, record.countable)


def near(horizon: float, typical: float) -> float:
    """A horizon (s) no further than a factor of five from the typical one: a bad fit must not set its own."""
    return float(np.clip(horizon, 0.2 * typical, 5.0 * typical))


def known_numbers(rig: RigFile) -> dict[str, float]:
    """What the rig file knows as single numbers, by name."""
    return {name: value for name in rig.kind.known if (value := rig.known_number(name)) is not None}
