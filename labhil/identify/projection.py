"""Residuals of a fit that neither its parameters nor its windows' states can explain, to first order.

Candidate terms are screened by what they explain of these residuals (``waves``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.penalised import Projected
from labhil.identify.problem import Linearised
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class ProjectedResiduals:
    """Residuals of a fit with its parameters and initial states projected out.

    Attributes:
        fitted: The fit.
        lin: The fit linearised.
        basis: (N·c, P) orthonormal basis of the parameters' slopes, states projected out.
        target: (N·c,) residuals with states and parameters projected out, in units of noise.
    """

    fitted: Fitted
    lin: Linearised
    basis: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, fitted: Fitted) -> ProjectedResiduals:
        """Linearise a fit at its estimate and project its residuals."""
        projected, lin = Projected.at(fitted.problem, fitted.solution.point, fitted.solution.residuals)
        basis = orthonormal(projected.slopes)
        return cls(fitted, lin, basis, projected.residuals - basis @ (basis.T @ projected.residuals))

    def residual_change(self, theta: FloatArray) -> FloatArray:
        """Change (N·c,) of the residuals by another parameter vector ``theta``, all states held."""
        solution = self.fitted.solution
        return self.fitted.problem.residuals_at(theta, solution.point.states) - solution.residuals

    def project_out_states(self, columns: FloatArray) -> FloatArray:
        """Columns (N·c, k) with the initial states projected out."""
        return self.fitted.problem.project(self.lin, columns)

    def project_out_all(self, columns: FloatArray) -> FloatArray:
        """Columns (N·c, k) with initial states and parameters projected out."""
        projected = self.project_out_states(columns)
        return projected - self.basis @ (self.basis.T @ projected)


def orthonormal(columns: FloatArray) -> FloatArray:
    """Orthonormal basis of the span of columns (N, k), without those of length zero."""
    length = np.linalg.norm(columns, axis=0)
    columns = columns[:, length > 1e-9 * max(float(length.max(initial=0.0)), 1e-300)]
    if not columns.shape[1]:
        return columns
    left, singular, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-8])
