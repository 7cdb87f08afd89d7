"""A cubic B-spline over one coordinate, and how rough it is (Eilers and Marx 1996)."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from labhil.signals import FloatArray

DEGREE = 3
QUADRATURE = 1001


class Spline:
    """Cubic B-splines on knots (k,) that cover low … high; constant outside.

    ``of`` places the knots half way between even ones and quantiles: dense where the data are, and nowhere
    so sparse that a range which was passed in a hurry is stiff.
    """

    def __init__(self, knots: FloatArray) -> None:
        self.knots = np.r_[[knots[0]] * DEGREE, knots, [knots[-1]] * DEGREE]
        self.low, self.high = float(knots[0]), float(knots[-1])
        self.count = len(knots) + DEGREE - 1
        self.narrowest = float(np.diff(knots).min())

    @classmethod
    def of(cls, values: FloatArray, count: int) -> Spline:
        """A spline of ``count`` functions over the range of some values (N,)."""
        shares = np.linspace(0.0, 1.0, count - DEGREE + 1)
        even = values.min() + shares * np.ptp(values)
        return cls(np.asarray(0.5 * (even + np.quantile(values, shares))))

    def design(self, x: FloatArray) -> FloatArray:
        """Values of all functions at ``x`` (m,), (m, count)."""
        inside = np.clip(x, self.low, self.high)
        return np.asarray(BSpline.design_matrix(inside, self.knots, DEGREE).toarray())

    def on(self, nodes: int) -> FloatArray:
        """Values of all functions at so many evenly spaced places, (nodes, count)."""
        if nodes not in self._grids:
            self._grids[nodes] = self.design(np.linspace(self.low, self.high, nodes))
        return self._grids[nodes]

    @cached_property
    def _grids(self) -> dict[int, FloatArray]:
        return {}

    @cached_property
    def roughness(self) -> FloatArray:
        """∫ f″² of the coordinate in units of its range, as a form of the coefficients, (count, count)."""
        x = np.linspace(self.low, self.high, QUADRATURE)
        second = (
            BSpline(self.knots, np.eye(self.count), DEGREE).derivative(2)(x) * (self.high - self.low) ** 2
        )
        return np.asarray(second.T @ second / QUADRATURE)
