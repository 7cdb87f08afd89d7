"""Sensitivities of the residuals, by finite differences over steps of the size of the standard errors.

Differences over tiny steps pick up the rounding of an adaptive integrator, or a kink where a body stops, so
that a direction which the data do not determine may look determined. Each singular direction of the first
slopes is therefore stepped again, by a share of its own standard error.
"""

from __future__ import annotations

import numpy as np

from labhil.identify.problem import Point, Problem
from labhil.signals import FloatArray

MIN_SIZE_FOR_FACTORS = 0.1
"""Size, in scales, from which a parameter is stepped by a factor: products of powers stay constant."""


def sensitivities(
    problem: Problem,
    point: Point,
    residuals: FloatArray,
    noise: float,
    *,
    step_in_errors: float = 0.3,
    min_step: float = 1e-4,
    max_step: float = 0.1,
    passes: int = 2,
) -> FloatArray:
    """Take slopes of the residuals by the scaled free parameters, states projected out.

    Args:
        problem: What is estimated.
        point: Where.
        residuals: (N·c,) those at ``point``.
        noise: Their standard deviation.
        step_in_errors: Step along a singular direction, in its standard errors.
        min_step: Relative step below which the slope of tiny differences is kept.
        max_step: Largest relative step.
        passes: Of stepping; the first separates poorly determined directions, the second measures them.

    Returns:
        (N·c, P).
    """
    lin = problem.linearise(point, residuals, central=True)
    slopes = problem.project(lin, lin.by_parameters)
    if not slopes.shape[1]:
        return slopes
    size = np.maximum(np.abs(point.z), 1.0)
    for _ in range(passes):
        left, singular, directions = np.linalg.svd(slopes * size, full_matrices=False)
        columns = left * singular
        for k, s in enumerate(singular):
            length = min(step_in_errors * noise / max(float(s), 1e-300), max_step)
            slope = (
                _step_slope(problem, point, residuals, directions[k], length) if length > min_step else None
            )
            if slope is not None:
                columns[:, k] = problem.project(lin, slope[:, None])[:, 0]
        slopes = columns @ directions / size
    return np.asarray(slopes)


def _step_slope(
    problem: Problem, point: Point, residuals: FloatArray, direction: FloatArray, length: float
) -> FloatArray | None:
    """Slope (N·c,) along a relative ``direction`` (P,), from both sides where the bounds leave room."""
    points = [_step_relative(problem, point.z, side * length * direction) for side in (1.0, -1.0)]
    above, below = (None if z is None else problem.residuals(Point(z, point.states)) for z in points)
    if above is not None and below is not None:
        return (above - below) / (2.0 * length)
    if above is not None:
        return (above - residuals) / length
    return None if below is None else (residuals - below) / length


def _step_relative(problem: Problem, z: FloatArray, step: FloatArray) -> FloatArray | None:
    """``z`` (P,) after a relative step; None where it leaves the bounds."""
    size = np.maximum(np.abs(z), 1.0)
    by_factor = np.abs(z) > MIN_SIZE_FOR_FACTORS
    moved = np.where(by_factor, z * np.exp(step * size / np.where(by_factor, z, 1.0)), z + step * size)
    if np.any(moved < problem.lower) or np.any(moved > problem.upper):
        return None
    return np.asarray(moved)
