"""What data know of functions of parameters that they do not know by themselves.

From a motor's speed dry friction and torque constant are known to a common factor only. Their ratio is well
known, and still not found from their covariance: the difference of huge numbers is lost in rounding. So the
directions that the data do not know are kept apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.identifiability import WEAK, relative_svd
from labhil.identify.statistics import robust_covariance
from labhil.signals import FloatArray

FAINT = 1e-2
"""Share of a slope that may lie in an unknown direction: slopes from differences are no better known."""


@dataclass(frozen=True, slots=True)
class Known:
    """Directions ``rows`` (k, P) in which relative changes of parameters are known; ``unknown`` ones.

    ``spread`` (k, k) is the covariance along the known ones, ``scale`` (P,) what a relative change is one of,
    in the parameters' units.
    """

    scale: FloatArray
    rows: FloatArray
    spread: FloatArray
    unknown: FloatArray

    @classmethod
    def of(cls, fitted: Fitted, jacobian: FloatArray) -> Known:
        """Of a fit and its projected Jacobian (N, P) by SI units; residuals may be correlated."""
        problem, solution = fitted.problem, fitted.solution
        parameters = [problem.model.parameters[i] for i in problem.free]
        scale, singular, rows = relative_svd(parameters, fitted.theta[problem.free], jacobian)
        known = singular * WEAK > fitted.noise
        along = (jacobian * scale) @ rows[known].T
        unit = np.maximum(np.linalg.norm(along, axis=0), 1e-300)
        spread = robust_covariance(
            along / unit, solution.residuals, fitted.dof, len(problem.sigma), problem.begins
        )
        return cls(scale, rows[known], spread / np.outer(unit, unit), rows[~known])

    def covariance(self, slopes: FloatArray) -> FloatArray:
        """That of functions with slopes (m, P) to first order, (m, m); infinite where one is not known."""
        scaled = slopes * self.scale
        along = scaled @ self.rows.T
        covariance = along @ self.spread @ along.T
        size = np.linalg.norm(scaled, axis=1)
        lost = np.linalg.norm(scaled @ self.unknown.T, axis=1) > FAINT * size
        covariance[lost, lost] = np.inf
        return np.asarray(covariance)
