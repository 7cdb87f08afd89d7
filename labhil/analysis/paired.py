"""Whether two models of one recording err differently by more than noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from labhil.signals import FloatArray, IntArray

FEWEST_BLOCKS = 12
"""Stretches whose errors are set beside each other; with fewer a t test has hardly any power."""

LARGEST_SQUARE = 1e200
"""Larger squares, and those of a simulation that ran away, count as this."""


def block_squares(
    errors: Sequence[FloatArray], windows: Sequence[IntArray], levels: FloatArray
) -> FloatArray:
    """Mean squared errors, in squared noise levels, of stretches of time (blocks,).

    Args:
        errors: Simulated − measured of each recording, (N, channels).
        windows: The number of the simulated window that each sample belongs to, (N,), of each recording.
        levels: The noise level of each channel, (channels,), in its unit.

    Returns:
        A number for each block: a block is a window, or an equal part of one where there are too few.
    """
    total = sum(len(np.unique(window)) for window in windows)
    parts = -(-FEWEST_BLOCKS // max(1, total))
    block_means: list[float] = []
    for error, window in zip(errors, windows, strict=True):
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.mean(np.square(error / levels), axis=1)
        squares = np.nan_to_num(squares, nan=LARGEST_SQUARE, posinf=LARGEST_SQUARE)
        for number in np.unique(window):
            pieces = np.array_split(np.minimum(squares[window == number], LARGEST_SQUARE), parts)
            block_means += [float(np.mean(piece)) for piece in pieces if len(piece)]
    return np.array(block_means)


def paired_p_value(better: FloatArray, worse: FloatArray) -> float:
    """Probability of errors that differ so much, if both models were equally good.

    A t test of the logarithms of the ratio of mean squares over the blocks: a ratio is as likely to be r as
    1/r where neither model is better. Neighbouring blocks may be correlated; that takes from their number.

    Args:
        better: Mean squared errors of the model with the smaller error in all, (blocks,).
        worse: The same of the other.

    Returns:
        The p value; 1 where the blocks speak for the other model, or are the same.
    """
    tiny = np.finfo(np.float64).tiny
    ratios = np.log(np.maximum(worse, tiny)) - np.log(np.maximum(better, tiny))
    mean, spread = float(np.mean(ratios)), float(np.std(ratios, ddof=1))
    if mean <= 0.0:
        return 1.0
    if spread <= 1e-12 * mean:
        return 0.0
    effective = max(2.0, len(ratios) * _independence(ratios))
    return float(2.0 * stats.t.sf(mean / spread * np.sqrt(effective), effective - 1.0))


def _independence(values: FloatArray) -> float:
    """Effective share of n values, (1 − ρ)/(1 + ρ) with ρ their autocorrelation at lag 1.

    The estimate r of ρ about an estimated mean is too small by (1 + 4ρ)/n (Kendall, Biometrika 41, 1954).
    """
    deviations, n = values - values.mean(), len(values)
    power = float(deviations @ deviations)
    if power <= 0.0 or n <= 4:
        return 1.0
    lag = float(deviations[1:] @ deviations[:-1]) / power
    corrected = min(max((n * lag + 1.0) / (n - 4.0), 0.0), 0.95)
    return (1.0 - corrected) / (1.0 + corrected)
