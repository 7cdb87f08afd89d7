"""The objectives: a large force that changes little along the stroke (eq. A.1 to A.3).

The text's second objective is the largest value of the normalised 1/(dF/dx). That is infinite for any curve
with a maximum or minimum inside the stroke; and the slope of a straight line through the curve is zero for
any symmetric arch. Here the slope of a curve is therefore the root mean square of dF/dx along the stroke,
which is zero for a constant force alone. The slope of the straight line, as in the text, is shown in
addition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labhil.optimise.circuit import PITCH, positions
from labhil.signals import FloatArray


def largest_force(curves: FloatArray) -> FloatArray:
    """Return the largest force (n,), N, of force curves (n, m)."""
    return np.asarray(curves.max(axis=1))


def rms_slope(curves: FloatArray) -> FloatArray:
    """Return the root mean square of dF/dx (n,), N/m, of force curves (n, m) at :func:`positions`."""
    return np.asarray(np.sqrt(np.mean((np.diff(curves, axis=1) / PITCH) ** 2, axis=1)))


def mean_slope(curves: FloatArray) -> FloatArray:
    """Return the slope (n,), N/m, of the straight line through each curve by least squares."""
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
        """Normalise by the force curves (n, m) of a database."""
        force, inverse = largest_force(curves), 1.0 / rms_slope(curves)
        return cls((float(force.min()), float(force.max())), (float(inverse.min()), float(inverse.max())))

    def __call__(self, curves: FloatArray) -> FloatArray:
        """Return CF1 (eq. A.2) and CF2 (eq. A.3), (n, 2).

        0 and 1 are the extremes of the reference curves.
        """
        low, high = self.force_range
        inverse_low, inverse_high = self.inverse_slope_range
        force = (largest_force(curves) - low) / (high - low)
        return np.stack(
            [force, (1.0 / rms_slope(curves) - inverse_low) / (inverse_high - inverse_low)], axis=1
        )


def pareto_front(values: FloatArray, apart: float = 0.0) -> NDArray[np.intp]:
    """Find the rows of values (n, 2), both to be maximised, that no other row dominates.

    Args:
        values: Pairs of objectives.
        min_distance: Least distance between two rows along the front.

    Returns:
        Row numbers by decreasing first value; the first of equal rows.
    """
    order = np.lexsort((-values[:, 1], -values[:, 0]))
    second = values[order, 1]
    before = np.concatenate([[-np.inf], np.maximum.accumulate(second)[:-1]])
    front = order[second > before]
    rows = [front[0]]
    for row in front[1:]:
        if np.linalg.norm(values[row] - values[rows[-1]]) >= apart:
            rows.append(row)
    return np.array(rows)
