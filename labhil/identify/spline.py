"""Cubic B-splines over one coordinate with a roughness penalty (P-splines: Eilers and Marx 1996).

``extended`` puts such a curve into a model as a force.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from labhil.signals import FloatArray

DEGREE = 3

QUADRATURE_POINTS = 1001
"""Points of the rectangle rule by which the roughness is integrated."""


class Spline:
    """Basis of cubic B-splines over a range; constant outside of it.

    Args:
        knots: (k,) rising; the first and the last are the ends of the range.

    Attributes:
        low: Lower end of the range; ``high`` the upper end.
        count: Number of basis functions, k + 2.
        narrowest: Smallest distance between knots.
    """

    def __init__(self, knots: FloatArray) -> None:
        self.knots = np.r_[[knots[0]] * DEGREE, knots, [knots[-1]] * DEGREE]
        self.low, self.high = float(knots[0]), float(knots[-1])
        self.count = len(knots) + DEGREE - 1
        self.narrowest = float(np.diff(knots).min())

    @classmethod
    def of(cls, values: FloatArray, count: int) -> Spline:
        """Make a basis of ``count`` functions over the range of data.

        Knots lie half way between evenly spaced ones and quantiles: dense where data are dense, and not too
        sparse elsewhere, so that the curve stays flexible where the motion was fast.

        Args:
            values: (N,) of the coordinate.
            count: Number of basis functions, 4 or more.
        """
        shares = np.linspace(0.0, 1.0, count - DEGREE + 1)
        even = values.min() + shares * np.ptp(values)
        return cls(np.asarray(0.5 * (even + np.quantile(values, shares))))

    def design(self, x: FloatArray) -> FloatArray:
        """Values (m, count) of all basis functions at ``x`` (m,)."""
        inside = np.clip(x, self.low, self.high)
        return np.asarray(BSpline.design_matrix(inside, self.knots, DEGREE).toarray())

    def on(self, nodes: int) -> FloatArray:
        """Values (nodes, count) of all basis functions at evenly spaced points of the range; cached."""
        if nodes not in self._grids:
            self._grids[nodes] = self.design(np.linspace(self.low, self.high, nodes))
        return self._grids[nodes]

    @cached_property
    def _grids(self) -> dict[int, FloatArray]:
        return {}

    @cached_property
    def roughness(self) -> FloatArray:
        """Matrix (count, count) of ∫ f″² as a form of the coefficients; the range has the length one."""
        x = np.linspace(self.low, self.high, QUADRATURE_POINTS)
        second = (
            BSpline(self.knots, np.eye(self.count), DEGREE).derivative(2)(x) * (self.high - self.low) ** 2
        )
        return np.asarray(second.T @ second / QUADRATURE_POINTS)
