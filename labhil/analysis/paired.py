"""Paired test of two models on one recording: whether their errors differ by more than noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from labhil.signals import FloatArray, IntArray

MAX_SQUARE = 1e200
"""Value of larger squared errors, and of those of a diverged simulation: means stay finite."""


def block_squares(
    errors: Sequence[FloatArray],
    windows: Sequence[IntArray],
    levels: FloatArray,
    *,
    min_blocks: int = 12,
) -> FloatArray:
    """Average squared errors over blocks of time.

    Args:
        errors: Simulated − measured of each recording, (N, channels).
        windows: The number of the simulated window that each sample belongs to, (N,), of each recording.
        levels: The noise level of each channel, (channels,), in its unit.
        min_blocks: Number of blocks below which a t test has hardly any power.

    Returns:
        (blocks,) mean squared errors in squared noise levels. A block is a window, or an equal part of one
        where there are fewer windows than ``min_blocks``.
    """
    total = sum(len(np.unique(window)) for window in windows)
    parts = -(-min_blocks // max(1, total))
    block_means: list[float] = []
    for error, window in zip(errors, windows, strict=True):
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.mean(np.square(error / levels), axis=1)
        squares = np.nan_to_num(squares, nan=MAX_SQUARE, posinf=MAX_SQUARE)
        for number in np.unique(window):
            pieces = np.array_split(np.minimum(squares[window == number], MAX_SQUARE), parts)
            block_means += [float(np.mean(piece)) for piece in pieces if len(piece)]
    return np.array(block_means)


def paired_p_value(better: FloatArray, worse: FloatArray) -> float:
    """Test whether two models differ, with a t test of the log ratios of their mean squared errors.

    Where neither model is better, ratios r and 1/r of a block are equally likely. Correlation of neighbouring
    blocks reduces their effective number.

    Args:
        better: Mean squared errors of the model with the smaller error over all blocks, (blocks,).
        worse: Those of the other model, (blocks,).

    Returns:
        The p value of equally good models; 1 where the blocks favour the other model, or are the same.
    """
    tiny = np.finfo(np.float64).tiny
    ratios = np.log(np.maximum(worse, tiny)) - np.log(np.maximum(better, tiny))
    mean, spread = float(np.mean(ratios)), float(np.std(ratios, ddof=1))
    if mean <= 0.0:
        return 1.0
    if spread <= 1e-12 * mean:
        return 0.0
    effective = max(2.0, len(ratios) * _effective_fraction(ratios))
    return float(2.0 * stats.t.sf(mean / spread * np.sqrt(effective), effective - 1.0))


def _effective_fraction(values: FloatArray) -> float:
    """Effective fraction of n values, (1 − ρ)/(1 + ρ) with ρ their autocorrelation at lag 1.

    The estimate r of ρ about an estimated mean is too small by (1 + 4ρ)/n (Kendall, Biometrika 41, 1954).
    """
    deviations, n = values - values.mean(), len(values)
    power = float(deviations @ deviations)
    if power <= 0.0 or n <= 4:
        return 1.0
    lag = float(deviations[1:] @ deviations[:-1]) / power
    corrected = min(max((n * lag + 1.0) / (n - 4.0), 0.0), 0.95)
    return (1.0 - corrected) / (1.0 + corrected)
