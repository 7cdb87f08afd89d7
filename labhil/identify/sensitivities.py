"""Slopes of the residuals over steps as long as the data leave the parameters uncertain.

Differences over tiny steps see what statistics must not: the rounding of an integrator that adapts its
steps, a kink where a body stops. A direction of which the data know nothing then looks known by accident.
So each singular direction of the first slopes is stepped again, by a share of its own standard error.
"""

from __future__ import annotations

import numpy as np

from labhil.identify.problem import Point, Problem
from labhil.signals import FloatArray

SHARE = 0.3
"""Of a direction's standard error that is stepped."""

PASSES = 2
"""The first separates the directions of which the data know little, the second measures them."""

SHORTEST, LONGEST = 1e-4, 0.1
"""Relative steps."""

BY_FACTORS = 0.1
"""Share of its scale from which a parameter is stepped by factors: products of powers stay what they are."""


def sensitivities(problem: Problem, point: Point, residuals: FloatArray, noise: float) -> FloatArray:
    """Projected slopes (N·c, P) of the residuals by the scaled free parameters, at ``point``.

    ``noise`` is the standard deviation of the ``residuals`` (N·c,).
    """
    lin = problem.linearise(point, residuals, central=True)
    slopes = problem.project(lin, lin.by_parameters)
    if not slopes.shape[1]:
        return slopes
    size = np.maximum(np.abs(point.z), 1.0)
    for _ in range(PASSES):
        left, singular, directions = np.linalg.svd(slopes * size, full_matrices=False)
        columns = left * singular
        for k, s in enumerate(singular):
            length = min(SHARE * noise / max(float(s), 1e-300), LONGEST)
            slope = (
                _step_slope(problem, point, residuals, directions[k], length) if length > SHORTEST else None
            )
            if slope is not None:
                columns[:, k] = problem.project(lin, slope[:, None])[:, 0]
        slopes = columns @ directions / size
    return np.asarray(slopes)


def _step_slope(
    problem: Problem, point: Point, residuals: FloatArray, direction: FloatArray, length: float
) -> FloatArray | None:
    """Slope (N·c,) along a relative ``direction`` (P,), from both sides where bounds let it."""
    points = [_step_relative(problem, point.z, side * length * direction) for side in (1.0, -1.0)]
    above, below = (None if z is None else problem.residuals(Point(z, point.states)) for z in points)
    if above is not None and below is not None:
        return (above - below) / (2.0 * length)
    if above is not None:
        return (above - residuals) / length
    return None if below is None else (residuals - below) / length


def _step_relative(problem: Problem, z: FloatArray, step: FloatArray) -> FloatArray | None:
    """``z`` after a relative step; None where it leaves the bounds."""
    size = np.maximum(np.abs(z), 1.0)
    far = np.abs(z) > BY_FACTORS
    moved = np.where(far, z * np.exp(step * size / np.where(far, z, 1.0)), z + step * size)
    if np.any(moved < problem.lower) or np.any(moved > problem.upper):
        return None
    return np.asarray(moved)
