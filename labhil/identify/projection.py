"""What neither a fit's parameters nor its windows' states explain, to first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.penalised import Projected
from labhil.identify.problem import Linearised
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Unexplained:
    """Residuals of a fit beside what it can explain.

    ``basis`` (N·c, P) spans what parameters explain where states do what they can, ``target`` (N·c,) is what
    neither does.
    """

    fitted: Fitted
    lin: Linearised
    basis: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, fitted: Fitted) -> Unexplained:
        """Linearise a fit where it stands."""
        projected, lin = Projected.at(fitted.problem, fitted.solution.point, fitted.solution.residuals)
        basis = orthonormal(projected.slopes)
        return cls(fitted, lin, basis, projected.residuals - basis @ (basis.T @ projected.residuals))

    def residual_change(self, theta: FloatArray) -> FloatArray:
        """What another vector ``theta`` changes in the residuals, (N·c,), all states held."""
        solution = self.fitted.solution
        return self.fitted.problem.residuals_at(theta, solution.point.states) - solution.residuals

    def beside_states(self, columns: FloatArray) -> FloatArray:
        """Columns (N·c, k) without what states explain of them."""
        return self.fitted.problem.project(self.lin, columns)

    def beside(self, columns: FloatArray) -> FloatArray:
        """Columns (N·c, k) without what states and parameters explain of them."""
        new = self.beside_states(columns)
        return new - self.basis @ (self.basis.T @ new)


def orthonormal(columns: FloatArray) -> FloatArray:
    """An orthonormal basis of the span of columns (N, k), those of no length left out."""
    length = np.linalg.norm(columns, axis=0)
    columns = columns[:, length > 1e-9 * max(float(length.max(initial=0.0)), 1e-300)]
    if not columns.shape[1]:
        return columns
    left, singular, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-8])
