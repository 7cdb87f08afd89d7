"""Marginal likelihood (evidence) of a structure in closed form, on a linear model of the residuals.

Residuals r (simulated − measured, in units of noise) are

    r = y + S·s + B·b + X·x,        r ~ N(0, σ²C),

where the columns of S, B and X are the changes of r by the windows' initial states s, by the parameters b of
the baseline, and by the parameters x of the structure's added terms. s and b have Gaussian priors as wide as
their scales. These are much wider than their posteriors, so they matter only where the data stop to determine
a state or a parameter: without them a model that makes one unobservable would gain evidence. C is the
covariance of the noise and of a slow disturbance (disturbance.py) of size τ, which is marginalised over a
grid that includes zero. x has a unit-information prior (Kass and Wasserman 1995) with precision L: the
response of a term has an RMS of κ noise levels, κ on a grid. The noise variance σ² is unknown, with ν degrees
of freedom. With G = XᵀX and g = Xᵀy after projection on the complement of S and B under C,

    log p(y | S, τ) = −½ log|C| − ½ log|SᵀC⁻¹S + I| − ½ log|BᵀB + I| − ½ log|G + L| + ½ log|L|
                      − ½ν·log(yᵀy − gᵀ(G + L)⁻¹g),

plus log 2Φ(m/s) for each parameter that cannot be negative, with its posterior mean m and standard deviation
s (O'Hagan and Forster 2004, ch. 11). The structures themselves are enumerated in enumerate.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, logsumexp

from labhil.signals import BoolArray, FloatArray, IntArray

DIAGONAL_REGULARISATION = 1e-9
"""Fraction of a Gram matrix's diagonal that is added to it: it stays invertible with equal columns."""


@dataclass(frozen=True, slots=True)
class WeightedProducts:
    """Inner products of columns under the covariance C of noise and one size of the disturbance.

    Attributes:
        products: (c, M, M), of each output separately, the windows' initial states projected out.
        log_density: terms of the log evidence that no structure changes, −½ log|C| − ½ log|SᵀC⁻¹S + I|.
    """

    products: FloatArray
    log_density: float


@dataclass(frozen=True, slots=True)
class GramMatrices:
    """Inner products of the target and all responses, for each of T sizes of the disturbance.

    Attributes:
        projected: (T, m, m), the target first, the baseline's responses projected out.
        by_output: (c, m, m), those without a disturbance, of each output separately.
        affects: (c, m), whether a column changes an output.
        raw: (m, m), without a disturbance and before the baseline is projected out; it scales the prior.
        precision: (m, m), prior precision at which a term's response has an RMS of one noise level.
        log_weight: (T,), log prior of the size of the disturbance plus what no structure changes.
        log_prior: (T,), log prior of the size of the disturbance.
        samples: rows of the columns.
        remaining: rows less the windows' states and the baseline's parameters.
        dof: the independent ones among the remaining rows.
    """

    projected: FloatArray
    by_output: FloatArray
    affects: BoolArray
    raw: FloatArray
    precision: FloatArray
    log_weight: FloatArray
    log_prior: FloatArray
    samples: int
    remaining: float
    dof: float

    def residual_mean_squares(self, columns: Sequence[int]) -> FloatArray:
        """Mean squares (c,) of the residuals of each output after least squares on these columns."""
        chosen = np.asarray(columns, dtype=np.int64)
        gram = _regularise(self.projected[0][np.ix_(chosen, chosen)][None])[0]
        sizes = np.linalg.solve(gram, -self.projected[0][chosen, 0]) if len(chosen) else np.empty(0)
        places, factors = np.r_[0, chosen], np.r_[1.0, sizes]
        squares = np.einsum("i,cij,j->c", factors, self.by_output[:, places[:, None], places], factors)
        return np.asarray(np.maximum(squares, 0.0) * len(squares) / max(self.remaining - len(chosen), 1.0))

    def with_precisions(self, blocks: Sequence[tuple[range, FloatArray | None]]) -> GramMatrices:
        """Return the same matrices with a prior for each block of responses.

        Args:
            blocks: columns of a block, and its prior precision (k, k) up to a factor. None stands for unit
                information, the block's own Gram matrix. The factor is chosen so that the block's response
                has an RMS of one noise level on average over the prior.
        """
        precision = np.zeros_like(self.raw)
        for places, given in blocks:
            block = np.ix_(places, places)
            form = self.raw[block] if given is None else given
            width = len(places)
            expected_squares = (
                width if given is None else float(np.trace(np.linalg.solve(given, self.raw[block])))
            )
            precision[block] = form * (expected_squares / self.samples)
        return replace(self, precision=precision)


def build_gram_matrices(
    weighted: Iterable[WeightedProducts],
    baseline: int,
    affects: BoolArray,
    samples: int,
    remaining: float,
    dof: float,
    log_prior: FloatArray,
    *,
    negligible: float = 50.0,
) -> GramMatrices:
    """Project the baseline out of inner products, once for all structures.

    Args:
        weighted: inner products of the target, the baseline's P responses and all terms' responses, in this
            order, for each size of the disturbance; the first size is zero.
        baseline: P.
        affects: (c, M), whether a column changes an output.
        samples: rows of the columns.
        remaining: rows less the windows' states.
        dof: the independent ones among the remaining rows.
        log_prior: (T,), log prior of the sizes of the disturbance, in ascending order.
        negligible: log odds against a size from which that and all larger ones are left out. They are those
            of no added term: what terms explain needs no disturbance.

    Returns:
        Inner products of the target and the terms' responses, for each size, without a prior precision.
    """
    target_and_terms = np.r_[0, np.arange(1 + baseline, affects.shape[1])]
    projected: list[FloatArray] = []
    by_output, raw, logs, alone = np.empty(0), np.empty(0), list[float](), list[float]()
    for at_size, weight in zip(weighted, log_prior, strict=True):
        products = at_size.products.sum(axis=0)
        inner = products[1 : 1 + baseline, 1 : 1 + baseline]
        projection = _projection_beside(products, baseline)
        if not projected:
            by_output = np.einsum("ia,cij,jb->cab", projection, at_size.products, projection, optimize=True)
            raw = products[np.ix_(target_and_terms, target_and_terms)]
        projected.append(products[target_and_terms] @ projection)
        log_det = float(np.linalg.slogdet(inner + np.eye(baseline))[1])
        logs.append(weight + at_size.log_density - 0.5 * log_det)
        total = max(float(projected[-1][0, 0]), 1e-300)
        alone.append(logs[-1] - 0.5 * (dof - baseline) * np.log(total))
        if alone[-1] < max(alone) - negligible:
            break
    rows = (samples, remaining - baseline, dof - baseline)
    return GramMatrices(
        np.array(projected),
        by_output,
        affects[:, target_and_terms],
        raw,
        np.zeros_like(raw),
        np.array(logs),
        log_prior[: len(logs)],
        *rows,
    )


def _projection_beside(products: FloatArray, baseline: int) -> FloatArray:
    """Matrix (M, m) that projects the baseline's P columns out of M columns and drops them."""
    count, block = len(products), slice(1, 1 + baseline)
    scale = np.sqrt(np.maximum(np.diag(products)[block], 1e-300))
    correlation = products[block, block] / np.outer(scale, scale) + DIAGONAL_REGULARISATION * np.eye(baseline)
    projection = np.eye(count)
    projection[block] = -np.linalg.solve(correlation, products[block] / scale[:, None]) / scale[:, None]
    return np.delete(projection, np.arange(1, 1 + baseline), axis=1)


KAPPA_GRID = np.array([0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4])
"""Prior RMS of a term's response in noise levels, each value equally probable. The grid covers effects
below the noise up to millimetres beside an encoder of a tenth of a micrometre."""

FIRST_KAPPAS = (3.0, float(KAPPA_GRID[-1]))
"""Prior RMS in noise levels with which responses are estimated first; the likelier end counts.

Beside a large disturbance the first holds a large response at zero, where its κ stays. Under the last,
responses that are nearly equal are large and cancel.
"""

MAX_KAPPA_ESTIMATES = 5
"""Largest number of estimates of κ from each."""


@dataclass(frozen=True, slots=True)
class Batch:
    """S structures with the same number k of responses.

    Attributes:
        columns: (S, k), columns of the Gram matrices (0 is the target).
        block: (S, k), number of the term that each response belongs to.
        positive: (S, k), whether a parameter cannot be negative.
    """

    columns: IntArray
    block: IntArray
    positive: np.ndarray


def log_evidence(grams: GramMatrices, batch: Batch) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log evidence of structures, and their posterior means.

    Args:
        grams: inner products of all responses.
        batch: S structures of k responses.

    Returns:
        Log evidence (S,) marginalised over the disturbance, up to a constant that all structures share; log
        evidence (S,) given that there is no disturbance; posterior means (S, k) of the parameters, in units
        of the responses, at the most probable size of the disturbance.
    """
    solved = solve(grams, batch)
    best = np.argmax(solved.logs, axis=0)
    sizes = solved.sizes[best, np.arange(len(best))]
    return logsumexp(solved.logs, axis=0), solved.logs[0] - grams.log_prior[0], sizes


def extended_evidence(
    grams: GramMatrices, batch: Batch, solved: StructureSolution, places: IntArray, positive: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Log evidence of every structure with each of V blocks added, by Schur complements.

    The priors κ of the structure's own terms are kept, so this is cheap and nearly exact.

    Args:
        grams: inner products of all responses.
        batch: S structures of k responses.
        solved: their solution.
        places: (V, w), columns of the responses of each block.
        positive: (V, w), whether a parameter cannot be negative.

    Returns:
        Log evidence (S, V) as of `log_evidence`, at the most probable κ of the new block; the same (S, V)
        given that there is no disturbance.
    """
    products = grams.projected
    cross = products[:, batch.columns[:, :, None, None], places]
    gradient = products[:, places, 0][:, None] + np.einsum("tskvw,tsk->tsvw", cross, solved.sizes)
    reduction = np.einsum("tskl,tslvw->tskvw", solved.inverse, cross, optimize=True)
    complement = _submatrices(products, places)[:, None] - np.einsum(
        "tskvw,tskvu->tsvwu", cross, reduction, optimize=True
    )
    scales = KAPPA_GRID[:, None, None, None, None, None] ** 2
    prior = _regularise(_submatrices(grams.precision, places) / scales)
    inverse, log_det = _inverse_and_log_det(_regularise(complement + prior))
    sizes = np.asarray(-np.einsum("...wu,...u->...w", inverse, gradient))
    squares = solved.penalised[..., None] + np.einsum("...w,...w->...", sizes, gradient)
    penalised = np.asarray(np.maximum(squares, 1e-12 * products[:, 0, 0, None, None]), dtype=np.float64)
    occam = 0.5 * (_inverse_and_log_det(prior)[1] - log_det)
    signs = _log_sign_gain(sizes, inverse, penalised, positive, grams.dof)
    gain = 0.5 * grams.dof * (np.log(solved.penalised)[..., None] - np.log(penalised))
    best = np.max(occam + signs + gain, axis=0)
    logs = solved.logs[..., None] + best - np.log(len(KAPPA_GRID))
    return logsumexp(logs, axis=0), logs[0] - grams.log_prior[0]


@dataclass(frozen=True, slots=True)
class StructureSolution:
    """Solution of S structures at each of T sizes of the disturbance.

    Attributes:
        logs: (T, S), log evidence.
        sizes: (T, S, k), posterior means.
        inverse: (T, S, k, k), inverse of G + L.
        penalised: (T, S), penalised sum of squares yᵀy − gᵀ(G + L)⁻¹g.
    """

    logs: FloatArray
    sizes: FloatArray
    inverse: FloatArray
    penalised: FloatArray


def solve(grams: GramMatrices, batch: Batch) -> StructureSolution:
    """Solve all structures at each size of the disturbance, under the likelier of two priors."""
    totals = np.maximum(grams.projected[:, 0, 0], 1e-300)[:, None]
    weight = grams.log_weight[:, None]
    count, k = batch.columns.shape
    if k == 0:
        logs = np.repeat(weight - 0.5 * grams.dof * np.log(totals), count, axis=1)
        shape = logs.shape
        return StructureSolution(
            logs, np.empty((*shape, 0)), np.empty((*shape, 0, 0)), np.repeat(totals, count, axis=1)
        )
    gram, gradient = _submatrices(grams.projected, batch.columns), grams.projected[:, batch.columns, 0]
    same = batch.block[:, :, None] == batch.block[:, None, :]
    unit = _submatrices(grams.precision, batch.columns) * same
    kappa = _estimate_kappas(grams, batch, gram, gradient, unit)
    prior = _regularise(unit / (kappa[..., :, None] * kappa[..., None, :]))
    inverse, log_det = _inverse_and_log_det(_regularise(gram + prior))
    sizes = np.asarray(-np.einsum("...ij,...j->...i", inverse, gradient))
    squares = totals + np.einsum("...i,...i->...", sizes, gradient)
    penalised = np.asarray(np.maximum(squares, 1e-12 * totals), dtype=np.float64)
    occam = 0.5 * (_inverse_and_log_det(prior)[1] - log_det)
    signs = _log_sign_gain(sizes, inverse, penalised, batch.positive, grams.dof)
    blocks = batch.block.max(axis=1) + 1
    logs = weight + occam + signs - blocks * np.log(len(KAPPA_GRID)) - 0.5 * grams.dof * np.log(penalised)
    likelier = np.argmax(logs, axis=0)[None]
    return StructureSolution(
        np.take_along_axis(logs, likelier, axis=0)[0],
        np.take_along_axis(sizes, likelier[..., None], axis=0)[0],
        np.take_along_axis(inverse, likelier[..., None, None], axis=0)[0],
        np.take_along_axis(penalised, likelier, axis=0)[0],
    )


def _estimate_kappas(
    grams: GramMatrices, batch: Batch, gram: FloatArray, gradient: FloatArray, unit: FloatArray
) -> FloatArray:
    """The κ (F, T, S, k) of the grid that each response has under a prior of that κ (MacKay 1992).

    ``FIRST_KAPPAS`` has the F values from which it is estimated.
    """
    same = (batch.block[:, :, None] == batch.block[:, None, :]).astype(float)
    raw = _submatrices(grams.raw, batch.columns) * same
    kappa = np.repeat(np.array(FIRST_KAPPAS), gradient.size).reshape(len(FIRST_KAPPAS), *gradient.shape)
    for _ in range(MAX_KAPPA_ESTIMATES):
        prior = unit / (kappa[..., :, None] * kappa[..., None, :])
        sizes = np.linalg.solve(_regularise(gram + prior), gradient[..., None])[..., 0]
        squares = np.einsum(
            "ftsi,sij->ftsj", sizes * np.einsum("ftsi,sij->ftsj", sizes, raw), same, optimize=True
        )
        before, kappa = kappa, _nearest_kappa(np.sqrt(np.maximum(squares, 0.0) / grams.samples))
        if np.array_equal(before, kappa):
            break
    return kappa


def _inverse_and_log_det(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverses (…, k, k) and log determinants (…) of positive definite matrices; no LAPACK for k = 1."""
    if matrices.shape[-1] == 1:
        return 1.0 / matrices, np.log(np.maximum(matrices[..., 0, 0], 1e-300))
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64), np.asarray(np.linalg.slogdet(matrices)[1])


def _log_sign_gain(
    sizes: FloatArray, inverse: FloatArray, penalised: FloatArray, positive: BoolArray, dof: float
) -> FloatArray:
    """Sum of log 2Φ(mean/deviation) over the parameters (…, S, k) that cannot be negative."""
    gains = np.zeros(sizes.shape)
    variance = np.clip(np.einsum("...ii->...i", inverse)[..., positive], 1e-300, 1e150)
    rows = np.nonzero(positive)[0]
    error = np.sqrt(variance * penalised[..., rows] / dof)
    gains[..., positive] = np.log(2.0) + log_ndtr(sizes[..., positive] / error)
    return np.asarray(gains.sum(axis=-1))


def _submatrices(matrix: FloatArray, columns: IntArray) -> FloatArray:
    """Submatrices (…, S, k, k) of matrices (…, m, m) with the columns (S, k) of each structure."""
    return np.asarray(matrix[..., columns[:, :, None], columns[:, None, :]])


def _regularise(matrices: FloatArray) -> FloatArray:
    """Matrices (…, k, k) with slightly larger diagonals, invertible also with equal columns."""
    lifted = matrices.copy()
    diagonal = np.einsum("...ii->...i", lifted)
    diagonal += DIAGONAL_REGULARISATION * np.abs(diagonal) + 1e-300
    return lifted


def _nearest_kappa(rms: FloatArray) -> FloatArray:
    """The κ of the grid that is nearest to each RMS on a logarithmic scale."""
    distance = np.abs(np.log(KAPPA_GRID) - np.log(np.maximum(rms, 1e-12))[..., None])
    return np.asarray(KAPPA_GRID[np.argmin(distance, axis=-1)])
