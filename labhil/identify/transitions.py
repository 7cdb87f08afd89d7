"""The response of a simulation to small forces, by linear maps from each sample to the next.

To first order, δx[n] = A[n] δx[n−1] + B[n] f[n] and δr[n] = C[n] δx[n], a linear system that varies with time
(Kailath, Linear Systems, 1980). x is the state at sample n, f the mean force over the step that leads to it,
r the residuals in units of noise. The maps are differences of simulations over single steps, with their
events. A few simulations give them; each further force then costs a sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from labhil.compiled import compiled
from labhil.identify.problem import Problem
from labhil.physics.record import Windows
from labhil.signals import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class TransitionOptions:
    """Options of the differences.

    Attributes:
        step: change of a state, in units of its scale.
        tolerance: largest deviation of single steps from the simulation, in units of the states' scale and of
            the noise; with a larger one, the model remembers more than its states.
    """

    step: float = 1e-3
    tolerance: float = 1e-2


@dataclass(frozen=True, slots=True)
class Transitions:
    """A simulation to first order from sample to sample; S states, c channels, N samples in all windows.

    Attributes:
        by_state: A, (N, S, S); that of a window's first sample is 0.
        by_force: B, (N, S), per unit of the force; 0 there, too.
        residuals_by_state: C, (N, c, S).
        ends: (N − W,) samples that a step leads to: all but the first of each window.
    """

    by_state: FloatArray
    by_force: FloatArray
    residuals_by_state: FloatArray
    ends: IntArray

    @classmethod
    def of(
        cls,
        problem: Problem,
        theta: FloatArray,
        states: FloatArray,
        forced: FloatArray,
        options: TransitionOptions = TransitionOptions(),
    ) -> Self | None:
        """Linearise a simulation.

        Args:
            problem: The problem, whose model tells its states among its coordinates.
            theta: Values of the model's parameters, (p,).
            states: Initial state of each window, (W, S).
            forced: The same values with a constant force of 1 unit.
            options: Options of the differences.

        Returns:
            The transitions; None where single steps from the states do not repeat the simulation.
        """
        model, record, windows = problem.model, problem.record, problem.windows
        names, scale = model.state_names, np.asarray(model.state_scale, dtype=np.float64)
        along = model.coordinates(theta, record, windows, states)
        if not set(names) <= along.keys():
            return None
        simulated = np.column_stack([along[name] for name in names])
        ends = np.flatnonzero(np.diff(windows.owner) == 0) + 1
        begins, changes = simulated[ends - 1], np.diag(options.step * scale)
        steps = Windows.of([(int(row), int(row) + 2) for row in windows.rows[ends - 1]])

        def after_step(values: FloatArray, begins: FloatArray) -> FloatArray:
            motion = model.coordinates(values, record, steps, begins)
            return np.column_stack([motion[name][1::2] for name in names])

        samples = problem.without_guess(Windows.of([(int(row), int(row) + 1) for row in windows.rows]))
        reached, residuals = after_step(theta, begins), samples.residuals_at(theta, simulated)
        deviation = np.abs(residuals - problem.residuals_at(theta, states)).max()
        if np.any(np.abs(reached - simulated[ends]) > options.tolerance * scale) or not (
            deviation <= options.tolerance
        ):
            return None
        count, size = simulated.shape
        by_state, by_force = np.zeros((count, size, size)), np.zeros((count, size))
        by_residual = np.empty((count, len(residuals) // count, size))
        by_force[ends] = after_step(forced, begins) - reached
        for s, change in enumerate(changes):
            by_state[ends, :, s] = (after_step(theta, begins + change) - reached) / change[s]
            slope = (samples.residuals_at(theta, simulated + change) - residuals) / change[s]
            by_residual[:, :, s] = slope.reshape(count, -1)
        return cls(by_state, by_force, by_residual, ends)

    def respond(self, forces: FloatArray) -> FloatArray:
        """Return the changes (N·c, k) of the residuals by forces (N, k), means over the steps to samples."""
        out = np.empty((*self.residuals_by_state.shape[:2], forces.shape[1]))
        is_first = np.ones(len(self.by_state), dtype=np.bool_)
        is_first[self.ends] = False
        _respond(self.by_state, self.by_force, self.residuals_by_state, is_first, forces, out)
        return out.reshape(-1, forces.shape[1])


@compiled
def _respond(
    by_state: FloatArray,
    by_force: FloatArray,
    by_states: FloatArray,
    is_first: BoolArray,
    forces: FloatArray,
    out: FloatArray,
) -> None:
    """Sum up the states' changes through each window."""
    samples, size = by_force.shape
    channels, columns = by_states.shape[1], forces.shape[1]
    change, before = np.zeros((size, columns)), np.zeros((size, columns))
    for n in range(samples):
        for s in range(size):
            for k in range(columns):
                before[s, k] = 0.0 if is_first[n] else change[s, k]
        for s in range(size):
            for k in range(columns):
                total = by_force[n, s] * forces[n, k]
                for r in range(size):
                    total += by_state[n, s, r] * before[r, k]
                change[s, k] = total
        for j in range(channels):
            for k in range(columns):
                total = 0.0
                for s in range(size):
                    total += by_states[n, j, s] * change[s, k]
                out[n, j, k] = total
