"""Covariance of the residuals under measurement noise and a slow disturbance, in the frequency domain.

In each window and channel the residuals of a correct model are noise that a first-order autoregression
whitens. Missing physics, or a disturbance of the plant, affects like a random force. The response of a
second-order plant to it is flat up to a corner frequency and falls with the square of the frequency beyond.
The discrete cosine transform of a window (Ahmed, Natarajan and Rao 1974) makes both nearly uncorrelated
across frequencies, so that the covariance is diagonal,

    C = diag(1 + τ²·s_k²),        s_k² = n / (2·(1 + (f_k / f₀)⁴)),

with the frequency f_k of the k-th of n cosines, the corner f₀, and the size τ in units of noise. The evidence
that uses it is in marginal.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import dct

from labhil.diagnose.structures.marginal import GramMatrices, WeightedProducts, build_gram_matrices
from labhil.identify.noise import CORRELATIONS, Noise
from labhil.identify.problem import Linearised, Problem
from labhil.signals import FloatArray

CHI_SQUARE_MEDIAN = 0.4549
"""Median of the square of a standard normal variable."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Grid of sizes of a disturbance with its prior.

    Attributes:
        size: (T,), sizes τ in units of noise; the first is zero.
        weight: (T,), prior probability of each size.
    """

    size: FloatArray
    weight: FloatArray

    @classmethod
    def near_estimate(cls, n_candidates: int) -> Disturbance:
        """Grid around a disturbance whose spectrum is estimated already; sizes are factors of that."""
        return cls.grid(n_candidates, (0.3, 1.0, 3.0))

    @classmethod
    def grid(
        cls, n_candidates: int, sizes: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3, 1e4, 1e5)
    ) -> Disturbance:
        """Grid of all sizes with a uniform prior; some disturbance is as probable as one more of the terms.

        Args:
            n_candidates: number of terms that may be added.
            sizes: sizes other than zero, in units of noise.
        """
        probability = 0.5 / (n_candidates + 1)
        return cls(
            np.r_[0.0, sizes], np.r_[1.0 - probability, np.full(len(sizes), probability / max(len(sizes), 1))]
        )


def compute_gram_matrices(
    problem: Problem,
    lin: Linearised,
    matrix: FloatArray,
    baseline: int,
    correlation: FloatArray,
    disturbance: Disturbance,
) -> GramMatrices:
    """Weight columns by the covariance for every size of a disturbance, and take their inner products.

    Args:
        problem: the fitted problem, N samples of c channels.
        lin: its linearisation where the fit stands.
        matrix: (N·c, M), the target, the baseline's responses and all terms' responses.
        baseline: number of the baseline's responses.
        correlation: (c,), first-order autocorrelation of the noise.
        disturbance: grid of sizes.

    Returns:
        Inner products with the windows' states and the baseline projected out, for each size.
    """
    rho = np.tile(correlation, len(problem.windows.owner))
    effective = np.minimum(1.0, problem.effective_fraction * (1.0 + rho) / (1.0 - rho))
    weight = np.sqrt(effective)[:, None]
    states = cosine_transform(problem, weight * whiten(problem, lin.by_states, correlation))
    columns = cosine_transform(problem, weight * whiten(problem, matrix, correlation))
    if problem.model.state_names:
        strength = force_response(problem)
    else:
        strength = estimate_torque_spectrum(problem, lin.residuals)
    weighted = (_weighted_products(problem, lin, states, columns, tau * strength) for tau in disturbance.size)
    free = lin.by_states.shape[1] * len(problem.edges)
    remaining, dof = (max(rows - free, 10.0) for rows in (len(matrix), float(effective.sum())))
    affects = np.any(matrix.reshape(-1, len(problem.sigma), matrix.shape[1]) != 0.0, axis=0)
    return build_gram_matrices(
        weighted, baseline, affects, len(matrix), remaining, dof, np.log(disturbance.weight)
    )


def _weighted_products(
    problem: Problem, lin: Linearised, states: FloatArray, columns: FloatArray, disturbance: FloatArray
) -> WeightedProducts:
    """Inner products under noise and a disturbance of this standard deviation (N·c,) at each frequency."""
    weight = 1.0 / np.sqrt(1.0 + disturbance**2)
    weighted = replace(lin, by_states=states * weight[:, None])
    projected = problem.project(weighted, columns * weight[:, None])
    gram = problem.state_gram(weighted.by_states)
    free = float(np.sum(np.linalg.slogdet(gram + np.eye(gram.shape[-1]))[1])) if states.size else 0.0
    by_output = projected.reshape(-1, len(problem.sigma), projected.shape[1]).transpose(1, 0, 2)
    return WeightedProducts(
        by_output.transpose(0, 2, 1) @ by_output, float(np.sum(np.log(weight))) - 0.5 * free
    )


def whiten(problem: Problem, columns: FloatArray, correlation: FloatArray) -> FloatArray:
    """Filter columns by the inverse of a first-order autoregression, window by window.

    Args:
        problem: the problem whose windows the rows belong to.
        columns: (N·c, k).
        correlation: (c,), first-order autocorrelation of each channel.

    Returns:
        Whitened columns (N·c, k); the first sample of each window is unchanged.
    """
    rho = np.asarray(correlation)[:, None]
    if not rho.any():
        return columns
    rows = columns.reshape(-1, len(problem.sigma), columns.shape[1])
    whitened = rows.copy()
    inside = np.flatnonzero(np.diff(problem.windows.owner) == 0) + 1
    whitened[inside] = (rows[inside] - rho * rows[inside - 1]) / np.sqrt(1.0 - rho**2)
    return whitened.reshape(columns.shape)


def cosine_transform(problem: Problem, columns: FloatArray) -> FloatArray:
    """Orthonormal cosine transform (N·c, k) of columns (N·c, k), of each window and channel separately."""
    if not columns.size:
        return columns
    rows = columns.reshape(-1, len(problem.sigma), columns.shape[1])
    transformed = np.empty_like(rows)
    for first, last in pairwise(_section_edges(problem)):
        transformed[first:last] = dct(rows[first:last], axis=0, norm="ortho")
    return transformed.reshape(columns.shape)


def force_response(problem: Problem, *, corner_in_cycles_per_horizon: float = 0.67) -> FloatArray:
    """Standard deviation of the response to a random force of size one, at each frequency.

    Args:
        problem: the problem whose windows are transformed.
        corner_in_cycles_per_horizon: frequency up to which the response is flat, in cycles per scored
            horizon.

    Returns:
        Standard deviations (N·c,) in units of noise, in the order of `cosine_transform`.
    """
    strength = np.empty(len(problem.windows.owner))
    for first, last in pairwise(_section_edges(problem)):
        count = last - first
        corner = 2.0 * corner_in_cycles_per_horizon * count * problem.record.period / problem.model.horizon
        strength[first:last] = np.sqrt(0.5 * count / (1.0 + (np.arange(count) / corner) ** 4))
    return np.repeat(strength, len(problem.sigma))


def estimate_spectral_noise(problem: Problem, residuals: FloatArray, *, slow_parts: int = 4) -> Noise:
    """Estimate the measurement noise of each channel from the fast part of the residuals' spectrum.

    Missing physics makes slow residuals, noise fast ones. Scale and autocorrelation maximise Whittle's (1953)
    likelihood of the median spectrum over the windows; with medians a few bad windows have little weight.

    Args:
        problem: the fitted problem.
        residuals: (N·c,), in units of the noise that the problem assumes.
        slow_parts: the slowest of so many equal parts of the spectrum is left out.

    Returns:
        Standard deviation in the channels' units and first-order autocorrelation, (c,) each.
    """
    channels, edges = len(problem.sigma), np.array(_section_edges(problem))
    spectrum = cosine_transform(problem, residuals[:, None])[:, 0].reshape(-1, channels) ** 2
    counts = np.diff(edges)
    n = int(counts.min())
    skipped = max(n // slow_parts, len(problem.model.state_names))
    rows = (edges[:-1, None] + np.arange(skipped, n)).ravel()
    power = np.median(spectrum[rows].reshape(len(counts), n - skipped, channels), axis=0) / CHI_SQUARE_MEDIAN
    shapes = _noise_shapes(n)[:, skipped:]
    best, scale = zip(*(_likeliest_shape(power[:, c], shapes) for c in range(channels)), strict=True)
    return Noise(problem.sigma * np.sqrt(scale), CORRELATIONS[list(best)])


def _likeliest_shape(power: FloatArray, shapes: FloatArray) -> tuple[int, float]:
    """Index of the shape (R, K) under which a spectrum (K,) is most likely, and its scale (Whittle 1953)."""
    # residuals of a part at rest may be exactly zero
    scales = np.maximum(np.mean(power / shapes, axis=1), np.finfo(np.float64).tiny)
    best = int(np.argmin(np.log(scales) + np.mean(np.log(shapes), axis=1)))
    return best, float(scales[best])


def _noise_shapes(count: int) -> FloatArray:
    """Spectra (R, count) of first-order autoregressive noise of unit variance, for each autocorrelation."""
    rho = CORRELATIONS[:, None]
    angle = np.pi * np.arange(count) / count
    return np.asarray((1.0 - rho**2) / (1.0 - 2.0 * rho * np.cos(angle) + rho**2))


def estimate_torque_spectrum(
    problem: Problem,
    residuals: FloatArray,
    *,
    sizes_in_noise: Sequence[float] = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4),
    corners_hz: Sequence[float] = (0.1, 0.3, 1.0, 3.0, 10.0),
) -> FloatArray:
    """Estimate the spectrum of the disturbance torque of each joint from residuals of inverse dynamics.

    A missing torque is a residual of inverse dynamics as it is. It is modelled as a first-order process with
    white noise added; its size and corner maximise Whittle's (1953) likelihood of the residuals' spectrum.

    Args:
        problem: a problem of inverse dynamics.
        residuals: (N·c,), in units of noise.
        sizes_in_noise: standard deviations that are tried, in units of the noise at each frequency.
        corners_hz: corner frequencies that are tried.

    Returns:
        Standard deviation (N·c,) at each frequency, in the order of `cosine_transform`.
    """
    sizes, corners = np.array(sizes_in_noise), np.array(corners_hz)
    power = cosine_transform(problem, residuals[:, None])[:, 0].reshape(-1, len(problem.sigma)) ** 2
    frequency = np.concatenate(
        [
            np.arange(b - a) / (2.0 * (b - a) * problem.record.period)
            for a, b in pairwise(_section_edges(problem))
        ]
    )
    slow = 1.0 / (1.0 + (frequency / corners[:, None]) ** 2)
    shapes = (1.0 + sizes[:, None, None] ** 2 * slow).reshape(-1, len(frequency))
    minus_log_likelihood = np.log(shapes).sum(axis=1)[:, None] + (1.0 / shapes) @ power
    size, corner = np.divmod(np.argmin(minus_log_likelihood, axis=0), len(corners))
    strength = sizes[size, None] * np.sqrt(slow[corner])
    return np.asarray(strength.T.ravel())


def _section_edges(problem: Problem) -> list[int]:
    """First row of each section that is transformed by itself, and the row after the last.

    A section is a window, since each begins in its own state; without states it lies between two gaps.
    """
    rows = problem.windows.rows
    if problem.model.state_names:
        return [*(problem.edges // len(problem.sigma)).tolist(), len(rows)]
    gaps = np.diff(problem.record.t[rows]) > 1.5 * problem.record.period
    return [0, *(np.flatnonzero(gaps) + 1).tolist(), len(rows)]
