"""Evidence of a structure in closed form, on linear responses.

Residuals r (simulated − measured, in units of noise, whitened, the windows' states projected out) are

    r = y + B·b + X·x,        e = r + τ·D·a,

with the baseline's responses B (flat prior on b), the responses X of the structure's terms, and a
disturbance that is smooth in time within each window: D holds cosines whose amplitude falls as 1/k², as the
response of a second-order plant to a random force does; a is standard normal, τ is summed out over a grid
that includes zero. A term's sizes have a unit-information prior (Kass and Wasserman 1995): the response of
its block has an RMS of κ noise levels, κ on a grid. The noise's scale is unknown. With G = XᵀX and b = Xᵀy,
both beside B and under the disturbance,

    log p(y | S, τ) = −½ log|I + τ²DDᵀ| − ½ log|BᵀB| − ½ log|G + L| + ½ log|L|
                      − ½ν·log(yᵀy − bᵀ(G + L)⁻¹b),

plus log 2Φ(m/s) for each size that cannot be negative (O'Hagan and Forster 2004, ch. 11).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr

from labhil.signals import FloatArray, IntArray

LEAST = 1e-9
"""Share of a Gram matrix's diagonal that is added to it, so that equal columns do no harm."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """The grid of sizes τ (T,) of a smooth disturbance, in units of noise, with its prior ``weight`` (T,)."""

    size: FloatArray
    weight: FloatArray

    @classmethod
    def grid(
        cls, candidates: int, sizes: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3, 1e4)
    ) -> Disturbance:
        """A disturbance is as likely as one more of so many ``candidates``, and of any size alike."""
        some = 0.5 / (candidates + 1)
        return cls(np.r_[0.0, sizes], np.r_[1.0 - some, np.full(len(sizes), some / max(len(sizes), 1))])


@dataclass(frozen=True, slots=True)
class Grams:
    """Inner products of target and responses under every τ, the baseline's responses taken out.

    ``seen`` (T, m, m) has the target first and all responses after it; ``raw`` (m, m) is the same without
    disturbance and before the baseline's responses are taken out: it sizes the prior, whose ``precision``
    (m, m) is that of responses of one noise level. ``log_prior`` (T,) is that of τ; ``log_weight`` (T,) has
    in it also what does not depend on the structure. ``samples`` is how many rows there are, ``dof`` how many
    independent ones are left.
    """

    seen: FloatArray
    raw: FloatArray
    precision: FloatArray
    log_weight: FloatArray
    log_prior: FloatArray
    samples: int
    dof: float

    def with_precisions(self, blocks: Sequence[tuple[range, FloatArray | None]]) -> Grams:
        """The same with the prior of each block of responses.

        It is the given precision, scaled so that the responses of the block have an RMS of one noise level on
        average over the prior; None stands for unit information, the block's own Gram matrix.
        """
        precision = np.zeros_like(self.raw)
        for places, stated in blocks:
            own = np.ix_(places, places)
            form = self.raw[own] if stated is None else stated
            width = len(places)
            energy = width if stated is None else float(np.trace(np.linalg.solve(stated, self.raw[own])))
            precision[own] = form * (energy / self.samples)
        return replace(self, precision=precision)


def grams(
    matrix: FloatArray,
    baseline: int,
    modes: FloatArray,
    strength: FloatArray,
    dof: float,
    disturbance: Disturbance,
) -> Grams:
    """Inner products for all structures.

    Args:
        matrix: (N, 1 + P + k) target, the baseline's P responses, and all terms' responses, whitened, the
            windows' states projected out.
        baseline: P.
        modes: (K, 1 + P + k) inner products of the disturbance's orthonormal modes with the columns.
        strength: (K,) singular values of the modes.
        dof: independent rows that are left beside the states of windows.
        disturbance: the grid of τ.

    Returns:
        The products of target and terms' responses with one another, under each τ.
    """
    plain = matrix.T @ matrix
    kept = np.r_[0, np.arange(1 + baseline, matrix.shape[1])]
    own = np.arange(1, 1 + baseline)
    seen, logs = [], []
    for tau, weight in zip(disturbance.size, disturbance.weight, strict=True):
        share = (tau * strength) ** 2 / (1.0 + (tau * strength) ** 2)
        gram = plain - modes.T @ (modes * share[:, None])
        inner = gram[np.ix_(own, own)]
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        inner = inner / np.outer(scale, scale) + LEAST * np.eye(baseline)
        across = gram[np.ix_(own, kept)] / scale[:, None]
        seen.append(gram[np.ix_(kept, kept)] - across.T @ np.linalg.solve(inner, across))
        logs.append(
            np.log(weight)
            - 0.5 * float(np.sum(np.log1p((tau * strength) ** 2)))
            - 0.5 * float(np.linalg.slogdet(inner)[1])
            - float(np.sum(np.log(scale)))
        )  # fmt: skip
    raw = plain[np.ix_(kept, kept)]
    logs_of = np.array(logs), np.log(disturbance.weight)
    return Grams(np.array(seen), raw, np.zeros_like(raw), *logs_of, len(matrix), dof - baseline)


KAPPA = np.array([0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
"""RMS of a term's response, in noise levels, that the prior holds possible, each as likely."""

FIRST_KAPPA = 3.0
"""The one with which the size of a response is estimated before the likeliest is taken."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Structures with the same number k of responses.

    ``columns`` (S, k) are places in the Gram matrices (0 is the target), ``block`` (S, k) numbers the term
    that each belongs to, ``positive`` (S, k) marks sizes that cannot be negative.
    """

    columns: IntArray
    block: IntArray
    positive: np.ndarray


def log_evidence(grams: Grams, batch: Batch) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evidence of structures, τ summed out, and the posterior means of their sizes under the likeliest τ.

    Args:
        grams: inner products of all responses.
        batch: S structures of k responses.

    Returns:
        Logarithms (S,), up to a constant that all structures share; the same without a disturbance (S,), its
        prior left out; and sizes (S, k).
    """
    raw = _gathered(grams.raw, batch.columns)
    logs, sizes = zip(*(_under(grams, t, raw, batch) for t in range(len(grams.log_weight))), strict=True)
    every = np.array(logs)
    best = np.argmax(every, axis=0)
    highest = every.max(axis=0)
    total = highest + np.log(np.sum(np.exp(every - highest), axis=0))
    return total, every[0] - grams.log_prior[0], np.array(sizes)[best, np.arange(len(best))]


def _under(grams: Grams, t: int, raw: FloatArray, batch: Batch) -> tuple[FloatArray, FloatArray]:
    """The same under one τ."""
    seen, total = grams.seen[t], grams.seen[t, 0, 0]
    k = batch.columns.shape[1]
    if k == 0:
        value = grams.log_weight[t] - 0.5 * grams.dof * np.log(total)
        return np.full(len(batch.columns), value), np.empty(batch.columns.shape)
    gram, pull = _gathered(seen, batch.columns), seen[batch.columns, 0]
    same = batch.block[:, :, None] == batch.block[:, None, :]
    unit = _gathered(grams.precision, batch.columns) * same
    first = gram + unit / FIRST_KAPPA**2
    response = np.linalg.solve(_lifted(first), pull[:, :, None])[:, :, 0]
    energy = response * np.einsum("sij,sj->si", raw * same, response)
    energy = np.einsum("si,sij->sj", energy, same.astype(float))
    kappa = _nearest(np.sqrt(np.maximum(energy, 0.0) / grams.samples))
    prior = _lifted(unit / (kappa[:, :, None] * kappa[:, None, :]))
    system = _lifted(gram + prior)
    inverse = np.linalg.inv(system)
    sizes = -np.einsum("sij,sj->si", inverse, pull)
    rest = np.maximum(total + np.einsum("si,si->s", sizes, pull), 1e-12 * total)
    occam = 0.5 * (np.linalg.slogdet(prior)[1] - np.linalg.slogdet(system)[1])
    error = np.sqrt(np.maximum(np.einsum("sii->si", inverse) * rest[:, None] / grams.dof, 1e-300))
    signs = np.where(batch.positive, np.log(2.0) + log_ndtr(sizes / error), 0.0).sum(axis=1)
    blocks = batch.block.max(axis=1) + 1
    logs = grams.log_weight[t] + occam + signs - blocks * np.log(len(KAPPA)) - 0.5 * grams.dof * np.log(rest)
    return logs, sizes


def _gathered(matrix: FloatArray, columns: IntArray) -> FloatArray:
    """The parts (S, k, k) of a matrix that belong to each structure."""
    return np.asarray(matrix[columns[:, :, None], columns[:, None, :]])


def _lifted(matrices: FloatArray) -> FloatArray:
    """The same (S, k, k) with a little on the diagonals, so that equal columns do no harm."""
    lifted = matrices.copy()
    diagonal = np.einsum("sii->si", lifted)
    diagonal += LEAST * np.abs(diagonal) + 1e-300
    return lifted


def _nearest(rms: FloatArray) -> FloatArray:
    """The κ of the grid that is nearest to each RMS, by ratio."""
    apart = np.abs(np.log(KAPPA) - np.log(np.maximum(rms, 1e-12))[..., None])
    return np.asarray(KAPPA[np.argmin(apart, axis=-1)])
