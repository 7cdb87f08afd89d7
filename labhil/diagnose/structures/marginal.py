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
    (m, m) is that of responses of one noise level. ``log_prior`` (T,) is that of τ; ``log_weight`` (T,) adds
    all that does not depend on the structure. ``samples`` is the number of rows, ``remaining`` that beside
    states and baseline, and ``dof`` how many of these are independent. ``by_output`` (c, m, m) are the first
    of ``seen`` of each output by itself, and ``acts`` (c, m) marks those that a response changes.
    """

    seen: FloatArray
    by_output: FloatArray
    acts: BoolArray
    raw: FloatArray
    precision: FloatArray
    log_weight: FloatArray
    log_prior: FloatArray
    samples: int
    remaining: float
    dof: float

    def rest(self, columns: Sequence[int]) -> FloatArray:
        """Mean squares (c,) that responses at these places leave of each output, by least squares."""
        chosen = np.asarray(columns, dtype=np.int64)
        gram = _regularise(self.seen[0][np.ix_(chosen, chosen)][None])[0]
        sizes = np.linalg.solve(gram, -self.seen[0][chosen, 0]) if len(chosen) else np.empty(0)
        places, factors = np.r_[0, chosen], np.r_[1.0, sizes]
        squares = np.einsum("i,cij,j->c", factors, self.by_output[:, places[:, None], places], factors)
        return np.asarray(np.maximum(squares, 0.0) * len(squares) / max(self.remaining - len(chosen), 1.0))

    def with_precisions(self, blocks: Sequence[tuple[range, FloatArray | None]]) -> Grams:
        """The same with the prior of each block of responses.

        It is the given precision, scaled so that the responses of the block have an RMS of one noise level on
        average over the prior; None stands for unit information, the block's own Gram matrix.
        """
        precision = np.zeros_like(self.raw)
        for places, given in blocks:
            block = np.ix_(places, places)
            form = self.raw[block] if given is None else given
            width = len(places)
            energy = width if given is None else float(np.trace(np.linalg.solve(given, self.raw[block])))
            precision[block] = form * (energy / self.samples)
        return replace(self, precision=precision)


def grams(
    views: Sequence[View],
    baseline: int,
    acts: BoolArray,
    samples: int,
    remaining: float,
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
        remaining: rows beside the states of windows.
        dof: independent ones of these.
        log_prior: (T,) of the sizes of the disturbance.

    Returns:
        The products of target and terms' responses with one another, under each size.
    """
    target_and_terms = np.r_[0, np.arange(1 + baseline, acts.shape[1])]
    seen, logs, projections = [], [], []
    for view, weight in zip(views, log_prior, strict=True):
        products = view.products.sum(axis=0)
        inner = products[1 : 1 + baseline, 1 : 1 + baseline]
        projections.append(_projection_beside(products, baseline))
        seen.append(products[target_and_terms] @ projections[-1])
        log_det = float(np.linalg.slogdet(inner + np.eye(baseline))[1])
        logs.append(weight + view.log_density - 0.5 * log_det)
    plain = views[0].products
    by_output = np.einsum("ia,cij,jb->cab", projections[0], plain, projections[0], optimize=True)
    raw = plain.sum(axis=0)[np.ix_(target_and_terms, target_and_terms)]
    rows = (samples, remaining - baseline, dof - baseline)
    return Grams(
        np.array(seen),
        by_output,
        acts[:, target_and_terms],
        raw,
        np.zeros_like(raw),
        np.array(logs),
        log_prior,
        *rows,
    )


def _projection_beside(products: FloatArray, baseline: int) -> FloatArray:
    """Matrix (M, m) that makes of columns (M) the target and all terms' responses beside the baseline's P."""
    count, block = len(products), slice(1, 1 + baseline)
    scale = np.sqrt(np.maximum(np.diag(products)[block], 1e-300))
    alike = products[block, block] / np.outer(scale, scale) + LEAST * np.eye(baseline)
    projection = np.eye(count)
    projection[block] = -np.linalg.solve(alike, products[block] / scale[:, None]) / scale[:, None]
    return np.delete(projection, np.arange(1, 1 + baseline), axis=1)


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
    solved = [_solve(grams, t, batch) for t in range(len(grams.log_weight))]
    logs = np.array([solution.logs for solution in solved])
    best = np.argmax(logs, axis=0)
    sizes = np.array([solution.sizes for solution in solved])[best, np.arange(len(best))]
    return logsumexp(logs, axis=0), logs[0] - grams.log_prior[0], sizes


def extended_evidence(
    grams: Grams, batch: Batch, places: IntArray, positive: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Evidence that structures would have with one more block each, their own priors left as they are.

    Args:
        grams: inner products of all responses.
        batch: S structures of k responses.
        places: (V, w) of the responses of each block that may be added.
        positive: (V, w) marks sizes that cannot be negative.

    Returns:
        Logarithms (S, V) as of `log_evidence`, for the likeliest κ of the new block, and the same without a
        disturbance.
    """
    precision = grams.precision[places[:, :, None], places[:, None, :]]
    logs = np.array(
        [_with_one_more(grams, t, batch, places, positive, precision) for t in range(len(grams.seen))]
    )
    return logsumexp(logs, axis=0), logs[0] - grams.log_prior[0]


def _with_one_more(
    grams: Grams, t: int, batch: Batch, places: IntArray, positive: BoolArray, precision: FloatArray
) -> FloatArray:
    """The logarithms (S, V) under one τ, by the Schur complement of each structure's system."""
    products, solved = grams.seen[t], _solve(grams, t, batch)
    across = products[batch.columns[:, :, None, None], places]
    pull = products[places, 0] + np.einsum("skvw,sk->svw", across, solved.sizes)
    reduction = np.einsum("skl,slvw->skvw", solved.inverse, across, optimize=True)
    complement = products[places[:, :, None], places[:, None, :]] - np.einsum(
        "skvw,skvu->svwu", across, reduction, optimize=True
    )
    best = np.full(pull.shape[:2], -np.inf)
    for kappa in KAPPA:
        prior = _regularise(precision / kappa**2)
        system = _regularise(complement + prior)
        inverse, log_det = _inverse_and_log_det(system)
        sizes = np.asarray(-np.einsum("svwu,svu->svw", inverse, pull))
        squares = solved.rest[:, None] + np.einsum("svw,svw->sv", sizes, pull)
        rest = np.asarray(np.maximum(squares, 1e-12 * products[0, 0]), dtype=np.float64)
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


def _solve(grams: Grams, t: int, batch: Batch) -> Solved:
    """Evidence of structures under one τ."""
    products, total = grams.seen[t], grams.seen[t, 0, 0]
    count, k = batch.columns.shape
    if k == 0:
        value = grams.log_weight[t] - 0.5 * grams.dof * np.log(total)
        rest = np.full(count, max(float(total), 1e-300))
        return Solved(np.full(count, value), np.empty((count, 0)), np.empty((count, 0, 0)), rest)
    gram, pull = _gather(products, batch.columns), products[batch.columns, 0]
    same = batch.block[:, :, None] == batch.block[:, None, :]
    unit = _gather(grams.precision, batch.columns) * same
    first = gram + unit / FIRST_KAPPA**2
    response = np.linalg.solve(_regularise(first), pull[:, :, None])[:, :, 0]
    energy = response * np.einsum("sij,sj->si", _gather(grams.raw, batch.columns) * same, response)
    energy = np.einsum("si,sij->sj", energy, same.astype(float))
    kappa = _nearest_kappa(np.sqrt(np.maximum(energy, 0.0) / grams.samples))
    prior = _regularise(unit / (kappa[:, :, None] * kappa[:, None, :]))
    system = _regularise(gram + prior)
    inverse, log_det = _inverse_and_log_det(system)
    sizes = np.asarray(-np.einsum("sij,sj->si", inverse, pull))
    squares = total + np.einsum("si,si->s", sizes, pull)
    rest = np.asarray(np.maximum(squares, 1e-12 * total), dtype=np.float64)
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


def _gather(matrix: FloatArray, columns: IntArray) -> FloatArray:
    """The parts (S, k, k) of a matrix that belong to each structure."""
    return np.asarray(matrix[columns[:, :, None], columns[:, None, :]])


def _regularise(matrices: FloatArray) -> FloatArray:
    """The same (…, k, k) with a little on the diagonals, so that equal columns do no harm."""
    lifted = matrices.copy()
    diagonal = np.einsum("...ii->...i", lifted)
    diagonal += LEAST * np.abs(diagonal) + 1e-300
    return lifted


def _nearest_kappa(rms: FloatArray) -> FloatArray:
    """The κ of the grid that is nearest to each RMS, by ratio."""
    apart = np.abs(np.log(KAPPA) - np.log(np.maximum(rms, 1e-12))[..., None])
    return np.asarray(KAPPA[np.argmin(apart, axis=-1)])
