"""What is optimised: a large force, and one that changes little along the stroke (A.1 to A.3).

The text's second objective is the largest value of the normalised 1/(dF/dx). As it stands that is infinite
for any curve with a maximum or minimum inside the stroke, however steep it is elsewhere; and the slope of a
straight line through the curve is zero for any symmetric arch. Here the slope of a curve is therefore one
positive number, the root of the mean square of dF/dx along the stroke, which is zero for a level curve and
for no other; the straight line's slope, which is what the text quotes, is shown beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labhil.optimise.circuit import PITCH, positions
from labhil.signals import FloatArray


def largest_force(curves: FloatArray) -> FloatArray:
    """(n,) N, of force curves (n, m)."""
    return np.asarray(curves.max(axis=1))


def rms_slope(curves: FloatArray) -> FloatArray:
    """(n,) N/m: root mean square of dF/dx, of force curves (n, m) at neighbouring :func:`positions`."""
    return np.asarray(np.sqrt(np.mean((np.diff(curves, axis=1) / PITCH) ** 2, axis=1)))


def mean_slope(curves: FloatArray) -> FloatArray:
    """(n,) N/m: slope of the straight line through each curve by least squares, with its sign."""
    x = positions() - positions().mean()
    return np.asarray(curves @ x / (x @ x))


@dataclass(frozen=True, slots=True)
class Objectives:
    """The two objectives, normalised by the smallest and largest values among reference curves."""

    force_range: tuple[float, float]
    """N."""
    inverse_slope_range: tuple[float, float]
    """m/N."""

    @classmethod
    def of(cls, curves: FloatArray) -> Objectives:
        """Normalisation by the force curves (n, m) of a database."""
        force, inverse = largest_force(curves), 1.0 / rms_slope(curves)
        return cls((float(force.min()), float(force.max())), (float(inverse.min()), float(inverse.max())))

    def __call__(self, curves: FloatArray) -> FloatArray:
        """(n, 2): CF1 of eq. A.2 and CF2 of eq. A.3; 0 and 1 are the extremes of the reference curves."""
        low, high = self.force_range
        inverse_low, inverse_high = self.inverse_slope_range
        force = (largest_force(curves) - low) / (high - low)
        return np.stack(
            [force, (1.0 / rms_slope(curves) - inverse_low) / (inverse_high - inverse_low)], axis=1
        )


def pareto_front(values: FloatArray, apart: float = 0.0) -> NDArray[np.intp]:
    """Rows of values (n, 2), both wanted large, that no other row beats in one without losing in the other.

    By falling first value; of equal rows the first. Of rows nearer than ``apart`` along the front only the
    first is returned.
    """
    order = np.lexsort((-values[:, 1], -values[:, 0]))
    second = values[order, 1]
    before = np.concatenate([[-np.inf], np.maximum.accumulate(second)[:-1]])
    front = order[second > before]
    kept = [front[0]]
    for row in front[1:]:
        if np.linalg.norm(values[row] - values[kept[-1]]) >= apart:
            kept.append(row)
    return np.array(kept)
