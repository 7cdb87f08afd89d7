"""How the solver of a co-simulation steps: the length of a step that it makes, and what its steps tell.

An Euler step tells the acceleration exactly, however long it is: the velocity's change over the step. Of any
other solver it is extrapolated from two steps, which is inexact where its steps are long.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from labhil.signals import FloatArray
from labhil.simulators.fmu_file import CoSimulationFmu, FmuFile
from labhil.simulators.pointwise import extrapolate_rates
from labhil.simulators.probing import FROM_SOLVER

PROBED_STATES = ((0.1, 0.3), (-0.2, 0.7))
"""States at which the order of position and velocity is determined."""

PROBED_INPUT = 0.25

ROUNDING = 1e-9
"""Difference of two states that rounding explains, relative to their size."""


class SolverStep(NamedTuple):
    """A step of a co-simulation.

    Attributes:
        length: Its length, s.
        is_euler: Whether it is one step by Euler, explicit, or with the new velocity (semi-implicit).
        error: Error of the extrapolated rate of the position, in velocities where these are above 1.
    """

    length: float
    is_euler: bool
    error: float

    @property
    def is_coarse(self) -> bool:
        """Whether accelerations are less exact than those of a fine solver."""
        return not self.is_euler and self.error > FROM_SOLVER.rate

    def rates(self, state: FloatArray, once: FloatArray, twice: FloatArray) -> tuple[float, float]:
        """Return the rates of position and velocity from the states after one and two steps."""
        if self.is_euler:
            return float(state[1]), float(once[1] - state[1]) / self.length
        return float(state[1]), float(extrapolate_rates(state, once, twice, self.length)[1])

    def note(self, file: FmuFile) -> str:
        """Return what a user should know of a coarse solver; empty for another."""
        if self.is_coarse:
            return (
                f"{file.path.name}: its solver is coarse: in steps of {self.length:g} s the rate of its "
                f"position is off by up to {self.error:.2g}; its accelerations, and what is fitted, are no "
                "better. Export it with shorter steps of its solver, or as model exchange."
            )
        if self.is_euler and self.error > FROM_SOLVER.rate:
            return (
                f"{file.path.name}: its solver makes Euler's steps of {self.length:g} s, which are coarse: "
                "its equations are fitted, integrated in shorter steps; runs by its own solver differ."
            )
        return ""


def find_step(fmu: CoSimulationFmu, file: FmuFile, starts: Mapping[int, float]) -> SolverStep | None:
    """Find a step in which the first variable of a pair moves with the second.

    Args:
        fmu: The instance, with a position and its velocity as its pair.
        file: The file, which may state the length of its steps.
        starts: Values of its parameters by value reference.

    Returns:
        The step; None where the first is not the position of the second in any step that the FMU makes.
    """
    for length in steps_to_try(file):
        steps = _step_twice(fmu, starts, length)
        if steps and all(_moves(*states, length) for states in steps):
            return SolverStep(
                length, all(_is_euler(*states, length) for states in steps), _error(steps, length)
            )
    return None


def steps_that_fail(fmu: CoSimulationFmu, file: FmuFile, starts: Mapping[int, float]) -> list[float]:
    """Return the lengths, s, that were tried and that the FMU refuses."""
    return [length for length in steps_to_try(file) if not _step_twice(fmu, starts, length)]


def steps_to_try(file: FmuFile, *, usual: Sequence[float] = (1e-3, 1e-2, 1e-4)) -> list[float]:
    """Return the lengths of a step to try, s: the FMU's own first, then ``usual`` ones."""
    fixed = file.description.coSimulation.fixedInternalStepSize
    default = file.description.defaultExperiment
    stated = None if default is None else default.stepSize
    return list(dict.fromkeys(float(length) for length in (fixed, *usual, stated) if length))


Steps = tuple[FloatArray, FloatArray, FloatArray]
"""A state, that after a step, and that after two."""


def _step_twice(fmu: CoSimulationFmu, starts: Mapping[int, float], length: float) -> list[Steps]:
    """Make two steps from each probed state; empty where the FMU refuses one."""
    found = []
    for state in PROBED_STATES:
        fmu.start(starts, state, PROBED_INPUT)
        once, twice = (fmu.try_step(PROBED_INPUT, length) for _ in range(2))
        if once is None or twice is None:
            return []
        found.append((np.array(state), np.array(once), np.array(twice)))
    return found


def _moves(
    state: FloatArray, once: FloatArray, twice: FloatArray, length: float, tolerance: float = 0.05
) -> bool:
    """Whether the position moved at a speed between those before and after the step.

    Every solver does so, Euler's at one of the two; ``tolerance`` is a share of the first velocity.
    """
    speed, slack = (once[0] - state[0]) / length, tolerance * abs(state[1])
    low, high = sorted((state[1], once[1]))
    return bool(low - slack <= speed <= high + slack)


def _is_euler(state: FloatArray, once: FloatArray, twice: FloatArray, length: float) -> bool:
    """Whether both steps moved the position at the first velocity, or both at the second."""
    speeds = np.array([once[0] - state[0], twice[0] - once[0]]) / length
    velocities = np.array([state[1], once[1], twice[1]])
    rounding = ROUNDING * (
        np.max(np.abs(velocities)) + np.max(np.abs([state[0], once[0], twice[0]])) / length
    )
    return any(bool(np.all(np.abs(speeds - v) <= rounding)) for v in (velocities[:2], velocities[1:]))


def _error(steps: Sequence[Steps], length: float) -> float:
    """Largest error of the extrapolated rate of the position, counted as in ``simulators.probing``."""
    return max(
        abs(float(extrapolate_rates(*states, length)[0]) - float(states[0][1]))
        / max(abs(float(states[0][1])), 1.0)
        for states in steps
    )
