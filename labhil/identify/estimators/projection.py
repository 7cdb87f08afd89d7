"""Variable projection (Golub and Pereyra 1973): a problem without its linear parameters.

Where the outputs are affine in some of the parameters, the best values of these for given values of the
others solve a linear least-squares problem, so that a search does not include them. The windows' initial
states are projected out by their slopes at the start, since measured velocities are too noisy to hold them
at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from labhil.identify.problem import Linearised, Point, Problem
from labhil.signals import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class ReducedProblem:
    """A problem over the free parameters that are not linear, initial states projected out to first order.

    Attributes:
        problem: The whole problem.
        states: (W, S) initial states at which it is linearised.
        slopes: Those of the residuals by the initial states.
        kept: (K,) indices of the nonlinear parameters among the free ones.
        linear: (L,) indices of the linear ones, which are solved for within their bounds.
    """

    problem: Problem
    states: FloatArray
    slopes: Linearised
    kept: IntArray
    linear: IntArray

    @classmethod
    def of(cls, problem: Problem, start: Point, *, project: bool = True) -> ReducedProblem:
        """Reduce a problem by the parameters that its model declares linear; by none without ``project``."""
        declared = [project and problem.model.parameters[i].linear for i in problem.free]
        is_linear = np.array(declared, dtype=bool)
        residuals = problem.residuals(start)
        by_states = problem.state_slopes(start, residuals)
        slopes = Linearised(residuals, np.empty((len(residuals), 0)), by_states)
        return cls(problem, start.states, slopes, np.flatnonzero(~is_linear), np.flatnonzero(is_linear))

    def solve(self, kept: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Solve for the linear parameters.

        Args:
            kept: (K,) scaled nonlinear parameters.

        Returns:
            All scaled free parameters (P,), and the residuals there (N·c,), in units of noise.
        """
        z = np.clip(np.zeros(len(self.problem.free)), self.problem.lower, self.problem.upper)
        z[self.kept] = kept
        residuals = self._residuals(z)
        if not len(self.linear) or not np.all(np.isfinite(residuals)):
            return z, residuals
        columns = self._columns(z, residuals)
        change = self._best_change(z, columns, residuals)
        z[self.linear] += change
        return z, residuals + columns @ change

    def cost(self, kept: FloatArray) -> float:
        """Sum of squared residuals for nonlinear parameters ``kept`` (K,), with the best linear ones."""
        _, residuals = self.solve(kept)
        return float(residuals @ residuals)

    def _residuals(self, z: FloatArray) -> FloatArray:
        """Residuals (N·c,) with the initial states projected out."""
        residuals = self.problem.residuals(Point(z, self.states))
        return self.problem.project(self.slopes, residuals[:, None])[:, 0]

    def _columns(self, z: FloatArray, residuals: FloatArray) -> FloatArray:
        """Slopes (N·c, L) by the linear parameters, from steps inside their bounds."""
        columns = np.empty((len(residuals), len(self.linear)))
        for k, j in enumerate(self.linear):
            shifted = z.copy()
            above, below = self.problem.upper[j] - z[j], z[j] - self.problem.lower[j]
            shifted[j] += min(1.0, above) if above >= min(1.0, below) else -min(1.0, below)
            step = shifted[j] - z[j]
            slope = (self._residuals(shifted) - residuals) / (step or 1.0)
            # a parameter that its bounds hold, or whose simulation diverges, stays where it is
            columns[:, k] = slope if np.all(np.isfinite(slope)) else 0.0
        return columns

    def _best_change(self, z: FloatArray, columns: FloatArray, residuals: FloatArray) -> FloatArray:
        """Least-squares change (L,) of the linear parameters, by bounded least squares at a bound."""
        room = (
            self.problem.lower[self.linear] - z[self.linear],
            self.problem.upper[self.linear] - z[self.linear],
        )
        size = np.linalg.norm(columns, axis=0)
        unit = np.where(size > 0.0, size, 1.0)
        q, r = np.linalg.qr(columns / unit)
        wanted = -q.T @ residuals
        change = np.linalg.lstsq(r, wanted, rcond=None)[0] / unit
        free = (room[0] < room[1]) & (size > 0.0)
        change[~free] = 0.0
        if np.any(change < room[0]) or np.any(change > room[1]):
            bounds = room[0][free] * unit[free], room[1][free] * unit[free]
            change[free] = lsq_linear(r[:, free], wanted, bounds=bounds).x / unit[free]
        return np.clip(change, *room)
