"""What lasts longer than noise and is no term: a random force, as its response adds to the residuals.

In each window and channel the residuals of a right model are noise that an autoregression of first order
whitens. What it lacks, or what disturbs the plant, acts like a random force: the response of a plant of
second order to it is flat up to a corner and falls with the square of the frequency from there on. The cosine
transform of a window takes an even spectrum apart into nearly independent parts (Ahmed, Natarajan and Rao
1974), so that the covariance of both is diagonal,

    C = diag(1 + τ²·s_k²),        s_k² = n / (2·(1 + (f_k / f₀)⁴)),

with frequency f_k of the k-th of n cosines, corner f₀, and size τ in units of noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import dct

from labhil.diagnose.structures.marginal import Grams, View, grams
from labhil.identify.noise import CORRELATIONS, Noise
from labhil.identify.problem import Linearised, Problem
from labhil.signals import FloatArray

CORNER = 0.67
"""Cycles per scored horizon up to which the response to a random force is flat."""

SLOW = 4
"""One of so many parts of a spectrum, the slowest one, says nothing of noise."""

TORQUE_SIZES = np.array([0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
"""Of a slow torque in each part of the spectrum, in units of the noise there."""

TORQUE_CORNERS = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
"""Hz up to which it is flat."""

MEDIAN = 0.4549
"""Median of the square of a normal variable of unit variance. By medians few windows count for little."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """The grid of sizes τ (T,) of a disturbance, in units of noise, with its prior ``weight`` (T,)."""

    size: FloatArray
    weight: FloatArray

    @classmethod
    def near_estimate(cls, candidates: int) -> Disturbance:
        """No disturbance, or one about as large as estimated, by factors."""
        return cls.grid(candidates, (0.3, 1.0, 3.0))

    @classmethod
    def grid(
        cls, candidates: int, sizes: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3, 1e4)
    ) -> Disturbance:
        """A disturbance is as likely as one more of so many ``candidates``, and of any size alike."""
        some = 0.5 / (candidates + 1)
        return cls(np.r_[0.0, sizes], np.r_[1.0 - some, np.full(len(sizes), some / max(len(sizes), 1))])


def inner_products(
    problem: Problem,
    lin: Linearised,
    matrix: FloatArray,
    baseline: int,
    correlation: FloatArray,
    disturbance: Disturbance,
) -> Grams:
    """Inner products of columns (N·c, m), the windows' states taken out, under every disturbance."""
    rho = np.tile(correlation, len(problem.windows.owner))
    worth = np.minimum(1.0, problem.effective_fraction * (1.0 + rho) / (1.0 - rho))
    weight = np.sqrt(worth)[:, None]
    states = spectra(problem, weight * whiten(problem, lin.by_states, correlation))
    columns = spectra(problem, weight * whiten(problem, matrix, correlation))
    if problem.model.state_names:
        strength = force_response(problem)
    else:
        strength = lasting_torque(problem, lin.residuals)
    views = [_view(problem, lin, states, columns, tau * strength) for tau in disturbance.size]
    free = lin.by_states.shape[1] * len(problem.edges)
    remaining, dof = (max(rows - free, 10.0) for rows in (len(matrix), float(worth.sum())))
    acts = np.any(matrix.reshape(-1, len(problem.sigma), matrix.shape[1]) != 0.0, axis=0)
    return grams(views, baseline, acts, len(matrix), remaining, dof, np.log(disturbance.weight))


def _view(
    problem: Problem, lin: Linearised, states: FloatArray, columns: FloatArray, disturbed: FloatArray
) -> View:
    """Inner products beside a disturbance of this standard deviation (N·c,) in each part of the spectrum."""
    weight = 1.0 / np.sqrt(1.0 + disturbed**2)
    weighted = replace(lin, by_states=states * weight[:, None])
    projected = problem.project(weighted, columns * weight[:, None])
    gram = problem.state_gram(weighted.by_states)
    free = float(np.sum(np.linalg.slogdet(gram + np.eye(gram.shape[-1]))[1])) if states.size else 0.0
    by_output = projected.reshape(-1, len(problem.sigma), projected.shape[1]).transpose(1, 0, 2)
    return View(by_output.transpose(0, 2, 1) @ by_output, float(np.sum(np.log(weight))) - 0.5 * free)


def whiten(problem: Problem, columns: FloatArray, correlation: FloatArray) -> FloatArray:
    """Columns (N·c, k) as an autoregression of first order leaves them, window by window."""
    rho = np.asarray(correlation)[:, None]
    if not rho.any():
        return columns
    rows = columns.reshape(-1, len(problem.sigma), columns.shape[1])
    white = rows.copy()
    inside = np.flatnonzero(np.diff(problem.windows.owner) == 0) + 1
    white[inside] = (rows[inside] - rho * rows[inside - 1]) / np.sqrt(1.0 - rho**2)
    return white.reshape(columns.shape)


def spectra(problem: Problem, columns: FloatArray) -> FloatArray:
    """Columns (N·c, k) with each window of each channel in its orthonormal cosine transform."""
    if not columns.size:
        return columns
    rows = columns.reshape(-1, len(problem.sigma), columns.shape[1])
    transformed = np.empty_like(rows)
    for first, last in pairwise(_edges(problem)):
        transformed[first:last] = dct(rows[first:last], axis=0, norm="ortho")
    return transformed.reshape(columns.shape)


def force_response(problem: Problem) -> FloatArray:
    """Standard deviation (N·c,) that a random force of size one adds to each part of the spectra."""
    strength = np.empty(len(problem.windows.owner))
    for first, last in pairwise(_edges(problem)):
        count = last - first
        corner = 2.0 * CORNER * count * problem.record.period / problem.model.horizon
        strength[first:last] = np.sqrt(0.5 * count / (1.0 + (np.arange(count) / corner) ** 4))
    return np.repeat(strength, len(problem.sigma))


def noise_beside(problem: Problem, residuals: FloatArray) -> Noise:
    """Noise of each channel beside the effects that a model lacks, separated by its spectrum.

    A model that lacks something leaves slow errors, noise quick ones. Size and correlation are those under
    which the quicker parts of the spectrum of the windows' residuals (N·c,) are likeliest (Whittle 1953).
    """
    channels, edges = len(problem.sigma), np.array(_edges(problem))
    spectrum = spectra(problem, residuals[:, None])[:, 0].reshape(-1, channels) ** 2
    counts = np.diff(edges)
    n = int(counts.min())
    skipped = max(n // SLOW, len(problem.model.state_names))
    rows = (edges[:-1, None] + np.arange(skipped, n)).ravel()
    power = np.median(spectrum[rows].reshape(len(counts), n - skipped, channels), axis=0) / MEDIAN
    shapes = _noise_shapes(n)[:, skipped:]
    best, scale = zip(*(_likeliest_shape(power[:, c], shapes) for c in range(channels)), strict=True)
    return Noise(problem.sigma * np.sqrt(scale), CORRELATIONS[list(best)])


def _likeliest_shape(power: FloatArray, shapes: FloatArray) -> tuple[int, float]:
    """Which of the shapes (R, K) a spectrum (K,) has likeliest, and its scale (Whittle 1953)."""
    # a part at rest may leave nothing at all
    scales = np.maximum(np.mean(power / shapes, axis=1), np.finfo(np.float64).tiny)
    best = int(np.argmin(np.log(scales) + np.mean(np.log(shapes), axis=1)))
    return best, float(scales[best])


def _noise_shapes(count: int) -> FloatArray:
    """Spectra (R, count) of noise of unit variance with each of the correlations of neighbours."""
    rho = CORRELATIONS[:, None]
    angle = np.pi * np.arange(count) / count
    return np.asarray((1.0 - rho**2) / (1.0 - 2.0 * rho * np.cos(angle) + rho**2))


def lasting_torque(problem: Problem, residuals: FloatArray) -> FloatArray:
    """Standard deviation (N·c,) in each part of the spectra of what inverse dynamics leaves of each joint.

    There a missing torque is among the residuals as it is, and each joint has its own. It is taken for a
    process of first order beside white noise, with the size and corner under which the spectrum of the
    residuals (N·c,) is likeliest (Whittle 1953).
    """
    power = spectra(problem, residuals[:, None])[:, 0].reshape(-1, len(problem.sigma)) ** 2
    frequency = np.concatenate(
        [np.arange(b - a) / (2.0 * (b - a) * problem.record.period) for a, b in pairwise(_edges(problem))]
    )
    lasting = 1.0 / (1.0 + (frequency / TORQUE_CORNERS[:, None]) ** 2)
    shapes = (1.0 + TORQUE_SIZES[:, None, None] ** 2 * lasting).reshape(-1, len(frequency))
    unlikely = np.log(shapes).sum(axis=1)[:, None] + (1.0 / shapes) @ power
    size, corner = np.divmod(np.argmin(unlikely, axis=0), len(TORQUE_CORNERS))
    strength = TORQUE_SIZES[size, None] * np.sqrt(lasting[corner])
    return np.asarray(strength.T.ravel())


def _edges(problem: Problem) -> list[int]:
    """First row of each stretch that is taken apart by itself, and the one after the last.

    Those are windows, for each begins in a state of its own; where there are no states, all between two gaps.
    """
    rows = problem.windows.rows
    if problem.model.state_names:
        return [*(problem.edges // len(problem.sigma)).tolist(), len(rows)]
    apart = np.diff(problem.record.t[rows]) > 1.5 * problem.record.period
    return [0, *(np.flatnonzero(apart) + 1).tolist(), len(rows)]
