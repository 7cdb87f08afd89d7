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
from labhil.identify.problem import Linearised, Problem
from labhil.signals import FloatArray

CORNER = 0.67
"""Cycles per scored horizon up to which the response to a random force is flat."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """The grid of sizes τ (T,) of a disturbance, in units of noise, with its prior ``weight`` (T,)."""

    size: FloatArray
    weight: FloatArray

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
    states = spectra(problem, whitened(problem, lin.by_states, correlation))
    columns = spectra(problem, whitened(problem, matrix, correlation))
    strength = response_to_a_force(problem) if problem.model.state_names else np.zeros(len(columns))
    views = [_view(problem, lin, states, columns, tau * strength) for tau in disturbance.size]
    rho = float(np.mean(correlation))
    telling = min(1.0, problem.telling * (1.0 + rho) / (1.0 - rho))
    free = lin.by_states.shape[1] * len(problem.edges)
    left, dof = (max(rows - free, 10.0) for rows in (len(matrix), len(matrix) * telling))
    return grams(views, baseline, len(matrix), left, dof, np.log(disturbance.weight))


def _view(
    problem: Problem, lin: Linearised, states: FloatArray, columns: FloatArray, disturbed: FloatArray
) -> View:
    """Inner products beside a disturbance of this standard deviation (N·c,) in each part of the spectrum."""
    weight = 1.0 / np.sqrt(1.0 + disturbed**2)
    weighted = replace(lin, by_states=states * weight[:, None])
    seen = problem.project(weighted, columns * weight[:, None])
    free = float(np.sum(np.linalg.slogdet(problem.state_gram(weighted.by_states))[1])) if states.size else 0.0
    return View(seen.T @ seen, float(np.sum(np.log(weight))) - 0.5 * free)


def whitened(problem: Problem, columns: FloatArray, correlation: FloatArray) -> FloatArray:
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
    if not problem.model.state_names:
        return columns
    rows = columns.reshape(-1, len(problem.sigma), columns.shape[1])
    found = np.empty_like(rows)
    for first, last in pairwise(_edges(problem)):
        found[first:last] = dct(rows[first:last], axis=0, norm="ortho")
    return found.reshape(columns.shape)


def response_to_a_force(problem: Problem) -> FloatArray:
    """Standard deviation (N·c,) that a random force of size one adds to each part of the spectra."""
    strength = np.empty(len(problem.windows.owner))
    for first, last in pairwise(_edges(problem)):
        count = last - first
        corner = 2.0 * CORNER * count * problem.record.period / problem.model.horizon
        strength[first:last] = np.sqrt(0.5 * count / (1.0 + (np.arange(count) / corner) ** 4))
    return np.repeat(strength, len(problem.sigma))


def _edges(problem: Problem) -> list[int]:
    """First row of each window, and the one after the last."""
    return [*(problem.edges // len(problem.sigma)).tolist(), len(problem.windows.owner)]
