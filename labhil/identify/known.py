"""Covariance of functions of parameters that are identifiable only in combination.

A motor's speed, for example, determines dry friction and torque constant only up to a common factor, but
their ratio well. The parameters' covariance does not show it, since the difference of huge numbers is lost in
rounding. The identifiable directions are therefore kept apart from the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.identifiability import WEAK_RELATIVE_ERROR, relative_svd
from labhil.identify.statistics import robust_covariance
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class IdentifiableDirections:
    """Directions of relative changes of the parameters that the data determine, and those they do not.

    Attributes:
        scale: (P,) the unit of a relative change, in the parameters' units.
        rows: (k, P) identifiable directions.
        spread: (k, k) covariance along these.
        unknown: (P − k, P) directions that are not identifiable.
    """

    scale: FloatArray
    rows: FloatArray
    spread: FloatArray
    unknown: FloatArray

    @classmethod
    def of(cls, fitted: Fitted, jacobian: FloatArray) -> IdentifiableDirections:
        """Find the directions of a fit; its residuals may be correlated.

        Args:
            fitted: The fit.
            jacobian: (N, P) of its residuals per SI unit, states projected out.
        """
        problem, solution = fitted.problem, fitted.solution
        parameters = [problem.model.parameters[i] for i in problem.free]
        scale, singular, rows = relative_svd(parameters, fitted.theta[problem.free], jacobian)
        known = singular * WEAK_RELATIVE_ERROR > fitted.noise
        along = (jacobian * scale) @ rows[known].T
        unit = np.maximum(np.linalg.norm(along, axis=0), 1e-300)
        spread = robust_covariance(
            along / unit, solution.residuals, fitted.dof, len(problem.sigma), problem.begins
        )
        return cls(scale, rows[known], spread / np.outer(unit, unit), rows[~known])

    def covariance(self, slopes: FloatArray, *, max_unknown_share: float = 1e-2) -> FloatArray:
        """Covariance of functions of the parameters, to first order.

        Args:
            slopes: (m, P) of the functions, per SI unit.
            max_unknown_share: Share of a slope that may lie in directions that are not identifiable; slopes
                from finite differences are no more exact.

        Returns:
            (m, m), with an infinite variance of functions that are not identifiable.
        """
        scaled = slopes * self.scale
        along = scaled @ self.rows.T
        covariance = along @ self.spread @ along.T
        size = np.linalg.norm(scaled, axis=1)
        undetermined = np.linalg.norm(scaled @ self.unknown.T, axis=1) > max_unknown_share * size
        covariance[undetermined, undetermined] = np.inf
        return np.asarray(covariance)
