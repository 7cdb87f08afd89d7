"""Interpolate the force curves of simulated designs.

The interpolation goes through every simulated curve: cubic radial functions on top of a full quadratic in
the five parameters, each scaled to its bounds, position by position. (The text interpolates "the median
values corresponding to the bounds" in MATLAB and does not say how.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from labhil.optimise.geometry import LOWER, UPPER
from labhil.optimise.objectives import largest_force, rms_slope
from labhil.signals import FloatArray

MIN_DISTANCE = 0.01
"""Least distance of designs, in ranges: closer ones would make the interpolation ill-conditioned."""

if TYPE_CHECKING:
    from scipy.interpolate import RBFInterpolator


@dataclass(frozen=True)
class Database:
    """Force curves of simulated designs."""

    designs: FloatArray
    """(n, 5) in m and rad."""
    curves: FloatArray
    """(n, m) in N."""

    @cached_property
    def _interpolant(self) -> RBFInterpolator:
        return _interpolant(self.designs, self.curves)

    def interpolate(self, designs: FloatArray) -> FloatArray:
        """Interpolate the force curves (k, m), N, of designs (k, 5), m and rad."""
        return np.asarray(self._interpolant(to_unit_box(designs)))

    def extend(self, designs: FloatArray, curves: FloatArray) -> Database:
        """Return a database with these designs (k, 5) and curves (k, m) in addition."""
        return Database(np.vstack([self.designs, designs]), np.vstack([self.curves, curves]))

    def leave_one_out(self) -> FloatArray:
        """Interpolate each simulated curve from the others, (n, m)."""
        rows = np.arange(len(self.curves))
        predicted = [
            _interpolant(self.designs[rows != n], self.curves[rows != n])(
                to_unit_box(self.designs[n : n + 1])
            )[0]
            for n in rows
        ]
        return np.array(predicted)


@dataclass(frozen=True, slots=True)
class InterpolationError:
    """Error of the interpolation at designs that are not in the database."""

    designs: int
    curve_rms: float
    """N, over all curves and positions."""
    curve_worst: float
    """N."""
    force_rms: float
    """N, of the largest force."""
    slope_rms: float
    """N/m, of the root-mean-square slope."""
    left_out_rms: float
    """N, of the database's own curves, each left out in turn."""


def select_distinct(candidates: FloatArray, known: FloatArray, distance: float = MIN_DISTANCE) -> FloatArray:
    """Select the candidates (k, 5) farther than ``distance`` (in ranges) from all known and earlier ones."""
    selected, new = list(to_unit_box(known)), []
    for candidate, point in zip(candidates, to_unit_box(candidates), strict=True):
        if not selected or np.min(np.linalg.norm(np.array(selected) - point, axis=1)) > distance:
            selected.append(point)
            new.append(candidate)
    return np.array(new).reshape(-1, candidates.shape[1])


def to_unit_box(designs: FloatArray) -> FloatArray:
    """Scale designs (n, 5), m and rad, to the ranges of Table A.2, 0 to 1."""
    return np.asarray((designs - LOWER) / (UPPER - LOWER))


def interpolation_error(database: Database, designs: FloatArray, curves: FloatArray) -> InterpolationError:
    """Compare the database with the circuit's curves (n, m) at designs (n, 5)."""
    predicted = database.interpolate(designs)
    error = predicted - curves
    return InterpolationError(
        len(designs),
        _rms(error),
        float(np.abs(error).max()),
        _rms(largest_force(predicted) - largest_force(curves)),
        _rms(rms_slope(predicted) - rms_slope(curves)),
        _rms(database.leave_one_out() - database.curves),
    )


def _interpolant(designs: FloatArray, curves: FloatArray) -> RBFInterpolator:
    from scipy.interpolate import RBFInterpolator

    return RBFInterpolator(to_unit_box(designs), curves, kernel="cubic", degree=2)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
