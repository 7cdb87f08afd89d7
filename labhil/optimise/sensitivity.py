"""Sensitivities of largest force and slope: at a design, and over all of Table A.2's ranges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labhil.optimise.circuit import force_curves
from labhil.optimise.geometry import LOWER, UPPER
from labhil.optimise.objectives import largest_force, rms_slope
from labhil.signals import FloatArray

STEP = 0.03
"""Step of the difference quotients, in ranges."""
CONFIDENCE = 0.95
RESAMPLES = 200

OUTPUTS = ("largest_force", "rms_slope")


@dataclass(frozen=True, slots=True)
class LocalSensitivity:
    """Sensitivities at a design, rows as in ``OUTPUTS``, columns as the parameters."""

    elasticity: FloatArray
    """(2, 5): (p/y)·∂y/∂p; NaN where the parameter is zero."""
    per_range: FloatArray
    """(2, 5): (range/y)·∂y/∂p: relative change if the parameter moved over its whole range at this rate."""


@dataclass(frozen=True, slots=True)
class GlobalSensitivity:
    """Sobol's indices over the box of Table A.2, rows as in ``OUTPUTS``, columns as the parameters."""

    first_order: FloatArray
    """(2, 5): share of the variance that the parameter explains alone."""
    total: FloatArray
    """(2, 5): share in which it takes part."""
    total_low: FloatArray
    total_high: FloatArray
    """(2, 5): 95 % interval of ``total`` by bootstrap."""
    evaluations: int


def local_sensitivity(design: FloatArray) -> LocalSensitivity:
    """Compute difference quotients of the circuit around a design (5,); one-sided at a bound."""
    step = STEP * (UPPER - LOWER)
    above, below = np.minimum(design + step, UPPER), np.maximum(design - step, LOWER)
    designs = np.vstack([_replace_each(design, above), _replace_each(design, below), design])
    y = _outputs(force_curves(designs))
    slope = (y[:, :5] - y[:, 5:10]) / (above - below)
    relative = slope / y[:, 10:]
    elasticity = np.where(np.abs(design) > 0.0, relative * design, np.nan)
    return LocalSensitivity(elasticity, relative * (UPPER - LOWER))


def global_sensitivity(
    curves_of: Callable[[FloatArray], FloatArray], samples: int, rng: np.random.Generator
) -> GlobalSensitivity:
    """Compute Sobol's indices over the box of Table A.2.

    Args:
        curves_of: Designs (n, 5) to force curves (n, m).
        samples: A power of two; 7 times as many designs are evaluated.
        rng: Random generator.

    Returns:
        The indices with bootstrap intervals.
    """
    from scipy.stats import qmc

    pairs = qmc.Sobol(10, seed=rng).random(samples)
    A, B = LOWER + pairs[:, :5] * (UPPER - LOWER), LOWER + pairs[:, 5:] * (UPPER - LOWER)
    mixed = np.repeat(A[None], 5, axis=0)
    for j in range(5):
        mixed[j, :, j] = B[:, j]
    y = _outputs(curves_of(np.vstack([A, B, mixed.reshape(-1, 5)])))
    f_AB = y[:, 2 * samples :].reshape(2, 5, samples).transpose(1, 0, 2)
    table = np.concatenate([y[:, :samples][None], y[:, samples : 2 * samples][None], f_AB])
    indices = _indices(table)
    resampled = [_indices(table[:, :, rng.integers(samples, size=samples)])[1] for _ in range(RESAMPLES)]
    low, high = np.quantile(resampled, [0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0], axis=0)
    return GlobalSensitivity(*indices, low, high, 7 * samples)


def _indices(table: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First-order and total indices (2, 5) from outputs (7, 2, n): of A, of B, and of A with columns of B."""
    from scipy.stats import sobol_indices

    indices = sobol_indices(func={"f_A": table[0], "f_B": table[1], "f_AB": table[2:]}, n=table.shape[2])
    return np.asarray(indices.first_order), np.asarray(indices.total_order)


def _outputs(curves: FloatArray) -> FloatArray:
    """Largest force and slope of curves (n, m), (2, n)."""
    return np.stack([largest_force(curves), rms_slope(curves)])


def _replace_each(design: FloatArray, values: FloatArray) -> FloatArray:
    """(5, 5): the design with one parameter after the other replaced."""
    rows = np.tile(design, (5, 1))
    np.fill_diagonal(rows, values)
    return rows
