"""Evaluate the right-hand side of a simulator at values of its parameters: compiled, or as a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labhil.physics import tabulated
from labhil.signals import FloatArray
from labhil.simulators.laws import Kernels, compile_kernels
from labhil.simulators.stepped import NonSmooth
from labhil.simulators.tables import OperatingRange, TableShape, fill_table

if TYPE_CHECKING:
    from labhil.simulators.simulator import Simulator

_KERNELS: dict[int, tuple[Simulator, Kernels]] = {}


def kernels_of(simulator: Simulator) -> Kernels:
    """Return the kernels of a simulator, compiled once in a process; all stepped ones share theirs."""
    if simulator.stepped is not None:
        return Kernels(tabulated.look_up, tabulated.pulls, tabulated.run, tabulated.run_pushed)
    entry = _KERNELS.get(id(simulator.f))
    if entry is None or entry[0].f is not simulator.f or entry[0].states != simulator.states:
        entry = _KERNELS[id(simulator.f)] = (simulator, compile_kernels(simulator))
    return entry[1]


class LocalDynamics(NamedTuple):
    """The right-hand side at some values of its parameters.

    Attributes:
        values: The simulator at these values, as the kernels take it.
        gain: Acceleration per unit of the input.
        inertia: Generalised force per acceleration.
        stiffness: Largest |∂f/∂x| at the operating points, 1/s².
        damping: Largest |∂f/∂v| at the operating points, 1/s.
    """

    values: Any
    gain: float
    inertia: float
    stiffness: float
    damping: float


class RightHandSide:
    """The right-hand side of a simulator, linearised at its operating points, with a cache.

    Args:
        simulator: The simulator.
        difference: Step of the difference quotients, SI.
        cache_size: Sets of parameter values whose linearisations (and tables) are kept.
    """

    def __init__(self, simulator: Simulator, *, difference: float = 1e-4, cache_size: int = 32) -> None:
        self._simulator, self._difference, self._cache_size = simulator, difference, cache_size
        self.non_smooth = NonSmooth() if simulator.stepped is None else simulator.stepped.non_smooth
        self._cache: dict[tuple[float, ...], LocalDynamics] = {}
        self._operating_points = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, 0.1]])
        self._range = OperatingRange()
        self._shape: TableShape | None = None

    def set_range(self, where: OperatingRange) -> None:
        """Set the range of a table."""
        self._range, self._shape = where, None
        self._cache.clear()

    def set_operating_points(self, points: FloatArray) -> None:
        """Set the points (n, 3) of position, velocity and input at which slopes are evaluated."""
        self._operating_points = points
        self._cache.clear()

    def at(self, numbers: tuple[float, ...]) -> LocalDynamics:
        """Linearise at these values of the parameters; most simulations change those of effects alone."""
        dynamics = self._cache.get(numbers)
        if dynamics is None:
            if len(self._cache) >= self._cache_size:
                self._cache.clear()
            dynamics = self._cache[numbers] = self._linearise(numbers)
        return dynamics

    def _linearise(self, numbers: tuple[float, ...]) -> LocalDynamics:
        p, f = self._kernel_argument(numbers), kernels_of(self._simulator).acceleration
        gain = f(0.0, 0.0, 1.0, p) - f(0.0, 0.0, 0.0, p)
        stated, h = self._stated_inertia(numbers), self._difference
        stiffness = damping = 0.0
        for x, v, u in self._operating_points.tolist():
            acceleration = f(x, v, u, p)
            stiffness = max(stiffness, abs(f(x + h, v, u, p) - acceleration) / h)
            damping = max(damping, abs(f(x, v + h, u, p) - acceleration) / h)
        inertia = abs(stated) if stated is not None else 1.0 / max(abs(gain), 1e-12)
        return LocalDynamics(p, gain, inertia, stiffness, damping)

    def _stated_inertia(self, numbers: tuple[float, ...]) -> float | None:
        if self._simulator.stepped is not None:
            return self._simulator.stepped.inertia(numbers)
        name = self._simulator.coordinate.inertia
        return dict(zip(self._simulator.parameters, numbers, strict=False)).get(name)

    def _kernel_argument(self, numbers: tuple[float, ...]) -> Any:
        """Return the simulator at these values, in the form that the kernels take."""
        if self._simulator.stepped is None:
            return self._simulator.records[2](*numbers)
        acceleration, clip = self._simulator.stepped.acceleration_at(numbers), self.non_smooth.clip
        if self._shape is None:
            name, rounding = self._simulator.name, self.non_smooth.rounding
            self._shape = TableShape.of(acceleration, self._range, name, rounding)
        return fill_table(acceleration, self._range, self._shape, clip)
