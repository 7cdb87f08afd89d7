"""Evidence of a structure in closed form, on linear responses.

Residuals r (simulated − measured, in units of noise) are

    r = y + S·s + B·b + X·x,        r ~ N(0, σ²C),

with the responses S of the windows' states and B of the baseline, and those X of the structure's terms.
States and sizes of the baseline have priors as wide as their scales, far wider than data leave them: it
counts only where one stops to show, else a model that makes it invisible would be rewarded. The covariance C
is that of noise and a lasting disturbance (disturbance.py) of size τ, which is summed out over a grid that
includes zero. A term's sizes have a unit-information prior (Kass and Wasserman 1995): the response of its
block has an RMS of κ noise levels, κ on a grid. The noise's scale is unknown. With G = XᵀX and b = Xᵀy, both
beside S and B and under C,

    log p(y | S, τ) = −½ log|C| − ½ log|SᵀC⁻¹S + I| − ½ log|BᵀB + I| − ½ log|G + L| + ½ log|L|
                      − ½ν·log(yᵀy − bᵀ(G + L)⁻¹b),

plus log 2Φ(m/s) for each size that cannot be negative (O'Hagan and Forster 2004, ch. 11).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, logsumexp

from labhil.signals import BoolArray, FloatArray, IntArray

LEAST = 1e-9
"""Share of a Gram matrix's diagonal that is added to it, so that equal columns do no harm."""


@dataclass(frozen=True, slots=True)
class View:
    """Inner products (c, M, M) of columns, of each output by itself, under one size of the disturbance.

    The states of the windows are taken out; ``log_density`` is what does not depend on the structure:
    −½ log|C| − ½ log|SᵀC⁻¹S + I| with the covariance C of noise and disturbance and the states' responses S.
    """

    products: FloatArray
    log_density: float


@dataclass(frozen=True, slots=True)
class Grams:
    """Inner products of target and responses under every τ, the baseline's responses taken out.

    ``seen`` (T, m, m) has the target first and all responses after it; ``raw`` (m, m) is the same without
    disturbance and before the baseline's responses are taken out: it sizes the prior, whose ``precision``
    (m, m) is that of responses of one noise level. ``log_prior`` (T,) is that of τ; ``log_weight`` (T,) has
    in it also what does not depend on the structure. ``samples`` is how many rows there are, ``left`` how
    many beside states and baseline, and ``dof`` how many of these are independent. ``by_output`` (c, m, m)
    are the first of ``seen`` of each output by itself, and ``acts`` (c, m) marks those that a response
    changes.
    """

    seen: FloatArray
    by_output: FloatArray
    acts: BoolArray
    raw: FloatArray
    precision: FloatArray
    log_weight: FloatArray
    log_prior: FloatArray
    samples: int
    left: float
    dof: float

    def rest(self, columns: Sequence[int]) -> FloatArray:
        """Mean squares (c,) that responses at these places leave of each output, by least squares."""
        own = np.asarray(columns, dtype=np.int64)
        gram = _lifted(self.seen[0][np.ix_(own, own)][None])[0]
        sizes = np.linalg.solve(gram, -self.seen[0][own, 0]) if len(own) else np.empty(0)
        places, factors = np.r_[0, own], np.r_[1.0, sizes]
        left = np.einsum("i,cij,j->c", factors, self.by_output[:, places[:, None], places], factors)
        return np.asarray(np.maximum(left, 0.0) * len(left) / max(self.left - len(own), 1.0))

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
    views: Sequence[View],
    baseline: int,
    acts: BoolArray,
    samples: int,
    left: float,
    dof: float,
    log_prior: FloatArray,
) -> Grams:
    """Inner products for all structures.

    Args:
        views: target, the baseline's P responses, and all terms' responses, as each size of the disturbance
            has them; the first one is none.
        baseline: P.
        acts: (c, M) marks the outputs that a column changes.
        samples: rows that the columns have.
        left: rows that are left beside the states of windows.
        dof: independent ones of these.
        log_prior: (T,) of the sizes of the disturbance.

    Returns:
        The products of target and terms' responses with one another, under each size.
    """
    kept = np.r_[0, np.arange(1 + baseline, acts.shape[1])]
    seen, logs, beside = [], [], []
    for view, weight in zip(views, log_prior, strict=True):
        every = view.products.sum(axis=0)
        inner = every[1 : 1 + baseline, 1 : 1 + baseline]
        beside.append(_beside(every, baseline))
        seen.append(every[kept] @ beside[-1])
        log_det = float(np.linalg.slogdet(inner + np.eye(baseline))[1])
        logs.append(weight + view.log_density - 0.5 * log_det)
    plain = views[0].products
    by_output = np.einsum("ia,cij,jb->cab", beside[0], plain, beside[0], optimize=True)
    raw = plain.sum(axis=0)[np.ix_(kept, kept)]
    rows = (samples, left - baseline, dof - baseline)
    return Grams(
        np.array(seen), by_output, acts[:, kept], raw, np.zeros_like(raw), np.array(logs), log_prior, *rows
    )


def _beside(products: FloatArray, baseline: int) -> FloatArray:
    """What makes of columns (M) the target and all terms' responses (m) beside the baseline's P, (M, m)."""
    count, own = len(products), slice(1, 1 + baseline)
    scale = np.sqrt(np.maximum(np.diag(products)[own], 1e-300))
    alike = products[own, own] / np.outer(scale, scale) + LEAST * np.eye(baseline)
    beside = np.eye(count)
    beside[own] = -np.linalg.solve(alike, products[own] / scale[:, None]) / scale[:, None]
    return np.delete(beside, np.arange(1, 1 + baseline), axis=1)


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
    solved = [_under(grams, t, batch) for t in range(len(grams.log_weight))]
    every = np.array([each.logs for each in solved])
    best = np.argmax(every, axis=0)
    sizes = np.array([each.sizes for each in solved])[best, np.arange(len(best))]
    return logsumexp(every, axis=0), every[0] - grams.log_prior[0], sizes


def promised(
    grams: Grams, batch: Batch, places: IntArray, positive: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """What the evidence of structures would be with one more block each, their own priors left as they are.

    Args:
        grams: inner products of all responses.
        batch: S structures of k responses.
        places: (V, w) of the responses of each block that may be added.
        positive: (V, w) marks sizes that cannot be negative.

    Returns:
        Logarithms (S, V) as of `log_evidence`, for the likeliest κ of the new block, and the same without a
        disturbance.
    """
    own = grams.precision[places[:, :, None], places[:, None, :]]
    every = np.array([_with_one_more(grams, t, batch, places, positive, own) for t in range(len(grams.seen))])
    return logsumexp(every, axis=0), every[0] - grams.log_prior[0]


def _with_one_more(
    grams: Grams, t: int, batch: Batch, places: IntArray, positive: BoolArray, own: FloatArray
) -> FloatArray:
    """The logarithms (S, V) under one τ, by the Schur complement of each structure's system."""
    seen, solved = grams.seen[t], _under(grams, t, batch)
    across = seen[batch.columns[:, :, None, None], places]
    pull = seen[places, 0] + np.einsum("skvw,sk->svw", across, solved.sizes)
    taken = np.einsum("skl,slvw->skvw", solved.inverse, across, optimize=True)
    complement = seen[places[:, :, None], places[:, None, :]] - np.einsum(
        "skvw,skvu->svwu", across, taken, optimize=True
    )
    best = np.full(pull.shape[:2], -np.inf)
    for kappa in KAPPA:
        prior = _lifted(own / kappa**2)
        system = _lifted(complement + prior)
        inverse, log_det = _inverse_and_log_det(system)
        sizes = np.asarray(-np.einsum("svwu,svu->svw", inverse, pull))
        left = solved.rest[:, None] + np.einsum("svw,svw->sv", sizes, pull)
        rest = np.asarray(np.maximum(left, 1e-12 * seen[0, 0]), dtype=np.float64)
        occam = 0.5 * (_inverse_and_log_det(prior)[1] - log_det)
        signs = _signs(sizes, inverse, rest, positive, grams.dof)
        gain = 0.5 * grams.dof * (np.log(solved.rest)[:, None] - np.log(rest))
        best = np.maximum(best, occam + signs + gain)
    return np.asarray(solved.logs[:, None] + best - np.log(len(KAPPA)))


@dataclass(frozen=True, slots=True)
class Solved:
    """Structures under one τ: log evidence (S,), sizes (S, k), inverses (S, k, k) of their systems, the rest.

    ``rest`` (S,) is what is left of the target's square, sizes beside their prior.
    """

    logs: FloatArray
    sizes: FloatArray
    inverse: FloatArray
    rest: FloatArray


def _under(grams: Grams, t: int, batch: Batch) -> Solved:
    """Evidence of structures under one τ."""
    seen, total = grams.seen[t], grams.seen[t, 0, 0]
    count, k = batch.columns.shape
    if k == 0:
        value = grams.log_weight[t] - 0.5 * grams.dof * np.log(total)
        rest = np.full(count, max(float(total), 1e-300))
        return Solved(np.full(count, value), np.empty((count, 0)), np.empty((count, 0, 0)), rest)
    gram, pull = _gathered(seen, batch.columns), seen[batch.columns, 0]
    same = batch.block[:, :, None] == batch.block[:, None, :]
    unit = _gathered(grams.precision, batch.columns) * same
    first = gram + unit / FIRST_KAPPA**2
    response = np.linalg.solve(_lifted(first), pull[:, :, None])[:, :, 0]
    energy = response * np.einsum("sij,sj->si", _gathered(grams.raw, batch.columns) * same, response)
    energy = np.einsum("si,sij->sj", energy, same.astype(float))
    kappa = _nearest(np.sqrt(np.maximum(energy, 0.0) / grams.samples))
    prior = _lifted(unit / (kappa[:, :, None] * kappa[:, None, :]))
    system = _lifted(gram + prior)
    inverse, log_det = _inverse_and_log_det(system)
    sizes = np.asarray(-np.einsum("sij,sj->si", inverse, pull))
    left = total + np.einsum("si,si->s", sizes, pull)
    rest = np.asarray(np.maximum(left, 1e-12 * total), dtype=np.float64)
    occam = 0.5 * (_inverse_and_log_det(prior)[1] - log_det)
    signs = _signs(sizes, inverse, rest, batch.positive, grams.dof)
    blocks = batch.block.max(axis=1) + 1
    logs = grams.log_weight[t] + occam + signs - blocks * np.log(len(KAPPA)) - 0.5 * grams.dof * np.log(rest)
    return Solved(logs, sizes, inverse, rest)


def _inverse_and_log_det(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverses (…, k, k) and log determinants (…) of positive definite matrices; a number needs no LAPACK."""
    if matrices.shape[-1] == 1:
        return 1.0 / matrices, np.log(np.maximum(matrices[..., 0, 0], 1e-300))
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64), np.asarray(np.linalg.slogdet(matrices)[1])


def _signs(
    sizes: FloatArray, inverse: FloatArray, rest: FloatArray, positive: BoolArray, dof: float
) -> FloatArray:
    """Log of how much likelier sizes (…, k) are positive than beforehand, where none can be negative."""
    variance = np.clip(np.einsum("...ii->...i", inverse), 1e-300, 1e150)
    error = np.sqrt(variance * rest[..., None] / dof)
    return np.asarray(np.where(positive, np.log(2.0) + log_ndtr(sizes / error), 0.0).sum(axis=-1))


def _gathered(matrix: FloatArray, columns: IntArray) -> FloatArray:
    """The parts (S, k, k) of a matrix that belong to each structure."""
    return np.asarray(matrix[columns[:, :, None], columns[:, None, :]])


def _lifted(matrices: FloatArray) -> FloatArray:
    """The same (…, k, k) with a little on the diagonals, so that equal columns do no harm."""
    lifted = matrices.copy()
    diagonal = np.einsum("...ii->...i", lifted)
    diagonal += LEAST * np.abs(diagonal) + 1e-300
    return lifted


def _nearest(rms: FloatArray) -> FloatArray:
    """The κ of the grid that is nearest to each RMS, by ratio."""
    apart = np.abs(np.log(KAPPA) - np.log(np.maximum(rms, 1e-12))[..., None])
    return np.asarray(KAPPA[np.argmin(apart, axis=-1)])
