"""Statistics of estimates: robust covariance, standard errors, Wald tests, and tests of the residuals.

The covariance does not assume white residuals. With the projected Jacobian J (states of the windows
taken out) and residuals r, both in units of noise,

    C = (JᵀJ)⁻¹ · S · (JᵀJ)⁻¹,   S = Γ₀ + Σ_l w_l·(Γ_l + Γ_lᵀ),   Γ_l = Σ_t J_t r_t r_{t−l} J_{t−l}ᵀ

with Bartlett's weights (Newey and West 1987) and Andrews' (1991) bandwidth, which lets the spread of the
residuals change with the regime but is biased low on short records; and, where it is larger, the same with
the autocovariance of an autoregressive model of each channel in the place of r_t r_{t−l}. Negative
correlation is not allowed to shrink a variance below the classical σ̂²(JᵀJ)⁻¹. Profiles and bootstraps are in
``intervals``, undetermined directions in ``identifiability``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import stats
from scipy.linalg import solve_toeplitz

from labhil.physics.terms import Parameter, keyed
from labhil.signals import FloatArray

ALPHA = 0.01
"""Significance level of tests and intervals of estimates: the 1 % that every result states."""

ALPHA_QUANTILE = float(stats.norm.ppf(1.0 - 0.5 * ALPHA))
"""Two-sided normal quantile at that level: half the width of an interval in standard errors."""

MIN_RELATIVE_SINGULAR = 1e-9
"""Singular values below this share of the largest count as that much: slopes are known to about 1e-7."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimated parameter with its error, interval and test.

    Of a value that was held, not estimated, ``std_error``, ``ci99``, ``z`` and ``p_value`` are NaN.

    Attributes:
        name: ``term.parameter``, or the name of a constant of the rig (whose ``term`` is None).
        joint: The joint of an arm that it belongs to; None for others.
        value: In ``unit``, as ``std_error`` and ``ci99`` (the interval at 99 %, cut at the bounds) are.
        std_error_reference: The reference text's formula, √C_ii/√n of the classical covariance, kept for
            comparison with its tables only: its intervals are far too narrow.
        p_value: Of the two-sided test that the value is zero.
        significant: The test rejects zero at 1 %, and the value is identifiable and not at a bound.
        identifiable: The data determine the value to better than its own size or scale.
        recording: Number of the recording, where each recording has a value of its own.
    """

    name: str
    term: str | None
    joint: int | None
    value: float
    unit: str
    std_error: float
    std_error_reference: float
    ci99: tuple[float, float]
    z: float
    p_value: float
    significant: bool
    identifiable: bool
    at_bound: bool
    recording: int | None = None

    @property
    def key(self) -> str:
        """Its name, unique among the parameters of a model."""
        return keyed(self.name, self.joint, self.recording)


def recording_slices(begins: Sequence[int], n: int) -> list[slice]:
    """Rows of each recording among ``n`` samples, where recordings begin at the rows ``begins``."""
    edges = [*begins, n]
    return [slice(a, b) for a, b in pairwise(edges)]


def robust_covariance(
    jacobian: FloatArray,
    residuals: FloatArray,
    dof: int,
    channels: int = 1,
    begins: Sequence[int] = (0,),
) -> FloatArray:
    """Estimate the covariance of least-squares estimates whose residuals may be correlated in time.

    The method is at the top of this file. Different recordings count as independent.

    Args:
        jacobian: (N, P) with the states projected out; the channels of one sample after the other.
        residuals: (N,) in the same units.
        dof: Degrees of freedom of the residuals.
        channels: Number of output channels.
        begins: Samples at which recordings begin.

    Returns:
        (P, P) in units of the Jacobian's parameters.
    """
    n = len(residuals)
    inverse = inverse_information(jacobian)
    classical = inverse * float(residuals @ residuals) / dof
    # correlation in time is between samples: the channels of each are added up
    scores = (jacobian * residuals[:, None]).reshape(n // channels, channels, -1).sum(axis=1)
    robust = inverse @ long_run_variance(scores, begins) @ inverse * (n / dof)
    modelled = inverse @ autoregressive_variance(jacobian, residuals, channels, begins) @ inverse * (n / dof)
    robust = _at_least(modelled, robust)
    floor, variances = np.diag(classical), np.diag(robust)
    undetermined = ~(variances > 1e-12 * floor)
    # along a direction that the data do not determine, rounding may make a variance zero or negative
    robust[undetermined, :] = robust[:, undetermined] = 0.0
    robust[undetermined, undetermined] = floor[undetermined]
    return _at_least(robust, classical)


def _at_least(covariance: FloatArray, floor: FloatArray) -> FloatArray:
    """A covariance (P, P) whose variances are raised, correlations kept, to those of ``floor`` (P, P)."""
    wanted = np.diag(floor)
    variances = np.maximum(np.diag(covariance), 1e-24 * wanted + 1e-300)
    factors = np.sqrt(np.maximum(1.0, wanted / variances))
    return np.asarray(covariance * np.outer(factors, factors))


def inverse_information(jacobian: FloatArray) -> FloatArray:
    """Invert the information matrix JᵀJ of a Jacobian (N, P) whose columns have about unit length.

    A direction that changes nothing gets a huge variance: singular values are raised to 1e-9 of the largest.

    Returns:
        (JᵀJ)⁻¹, (P, P).
    """
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=False)
    singular = np.maximum(singular, MIN_RELATIVE_SINGULAR * max(float(singular.max(initial=0.0)), 1e-130))
    return np.asarray((rows.T / singular**2) @ rows)


def differ_from_zero(
    values: FloatArray, covariance: FloatArray, n_candidates: int = 1, *, alpha: float = ALPHA
) -> bool:
    """Test whether values jointly differ from zero (Wald).

    Args:
        values: (k,) estimates.
        covariance: (k, k) of them; values with an infinite variance do not count.
        n_candidates: Number of sets of values of which these are the best (Bonferroni).
        alpha: Level of the test.
    """
    known = np.flatnonzero(np.isfinite(np.diag(covariance)))
    if not len(known):
        return False
    inverse = np.linalg.pinv(covariance[np.ix_(known, known)], hermitian=True)
    return bool(values[known] @ inverse @ values[known] > stats.chi2.isf(alpha / n_candidates, len(known)))


def lagged_product(rows: FloatArray, lag: int, begins: Sequence[int] = (0,)) -> FloatArray:
    """Σ_t row_t·row_{t−lag}ᵀ of rows (n, P) within each recording, (P, P)."""
    parts = [rows[recording] for recording in recording_slices(begins, len(rows))]
    return np.asarray(sum(part[lag:].T @ part[: len(part) - lag] for part in parts if len(part) > lag))


def lag_one_products(rows: FloatArray, begins: Sequence[int] = (0,)) -> FloatArray:
    """Each row (n, …) times the row before it in the same recording, (n − recordings, …)."""
    slices = recording_slices(begins, len(rows))
    return np.concatenate([rows[recording][1:] * rows[recording][:-1] for recording in slices])


def long_run_variance(scores: FloatArray, begins: Sequence[int] = (0,)) -> FloatArray:
    """Covariance (P, P) of the sum of rows (n, P) that are correlated in time, by a Bartlett kernel.

    Its bandwidth is that of :func:`bandwidth`; recordings, which begin at the rows ``begins``, are
    independent.
    """
    total = scores.T @ scores
    lags = bandwidth(scores, begins)
    for lag in range(1, lags + 1):
        weight = 1.0 - lag / (lags + 1)
        cross = lagged_product(scores, lag, begins)
        total = total + weight * (cross + cross.T)
    return np.asarray(total)


def autoregressive_variance(
    jacobian: FloatArray, residuals: FloatArray, channels: int, begins: Sequence[int] = (0,)
) -> FloatArray:
    """Covariance (P, P) of Jᵀr with an autoregressive model of each channel's residuals.

    Rows of ``jacobian`` (N, P) and ``residuals`` (N,) are the channels of one sample after the other.
    Channels are independent, and so are recordings, which begin at the samples ``begins``.
    """
    total = np.zeros((jacobian.shape[1], jacobian.shape[1]))
    for channel in range(channels):
        series, columns = residuals[channel::channels], jacobian[channel::channels]
        covariance = autocovariance(series, begins)
        total += covariance[0] * columns.T @ columns
        for lag in range(1, len(covariance)):
            cross = lagged_product(columns, lag, begins)
            total += covariance[lag] * (cross + cross.T)
    return total


def autocovariance(
    residuals: FloatArray,
    begins: Sequence[int] = (0,),
    *,
    max_order: int = 10,
    min_relative_covariance: float = 0.01,
) -> FloatArray:
    """Estimate autocovariances by an autoregression (Yule and Walker) whose order has the least AIC.

    Args:
        residuals: (n,) of one channel.
        begins: Rows at which recordings begin.
        max_order: Largest order that is tried.
        min_relative_covariance: Share of the variance below which covariances at further lags are left out.

    Returns:
        (lags + 1,) from lag 0.
    """
    n = len(residuals)
    orders = min(max_order, n // 10)
    power = float(residuals @ residuals) / n
    if power <= 0.0 or orders < 1:
        return np.array([power])
    measured = np.array([float(lagged_product(residuals, lag, begins)) for lag in range(orders + 1)]) / n
    best, weights, score = 0, np.empty(0), n * np.log(power)
    for order in range(1, orders + 1):
        candidate = solve_toeplitz(measured[:order], measured[1 : order + 1])
        innovation = measured[0] - float(candidate @ measured[1 : order + 1])
        if innovation > 0.0 and n * np.log(innovation) + 2.0 * order < score:
            best, weights, score = order, candidate, n * np.log(innovation) + 2.0 * order
    covariances = list(measured[: best + 1])
    smallest = min_relative_covariance * power
    while best and len(covariances) < n // 4 and max(abs(x) for x in covariances[-best:]) > smallest:
        covariances.append(float(weights @ covariances[: -best - 1 : -1]))
    return np.array(covariances)


def bandwidth(scores: FloatArray, begins: Sequence[int] = (0,)) -> int:
    """Andrews' (1991) bandwidth in lags for Bartlett's kernel, from an AR(1) of each column (n, P)."""
    n = len(scores)
    if n < 8:
        return 0
    scores = scores[:, np.any(scores, axis=0)]
    power = np.mean(scores**2, axis=0)
    rho = np.mean(lag_one_products(scores, begins), axis=0) / np.maximum(power, 1e-300)
    rho = np.clip(rho, -0.97, 0.97)
    # columns are weighted to have the same power, so only their correlations count
    innovation = (1.0 - rho**2) ** 2
    numerator = float(np.sum(4.0 * rho**2 * innovation / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)))
    denominator = float(np.sum(innovation / (1.0 - rho) ** 4))
    lags = 1.1447 * (numerator / max(denominator, 1e-300) * n) ** (1.0 / 3.0)
    return int(min(np.ceil(lags), n // 4))


def estimates(
    parameters: list[Parameter],
    values: FloatArray,
    covariance: FloatArray,
    classical: FloatArray,
    n: int,
    unknown: np.ndarray,
    intervals: Sequence[tuple[float, float]],
) -> list[Estimate]:
    """Put values, errors and intervals into a row per parameter, with a Wald test of each.

    Args:
        parameters: P of them.
        values: (P,) SI units.
        covariance: (P, P) robust covariance; a variance of zero marks a value that was held.
        classical: (P, P) covariance for white residuals.
        n: Number of residuals.
        unknown: (P,) of bool, parameters of a direction that the data do not determine.
        intervals: Lower and upper ends for each parameter; they are cut at its bounds here.

    Returns:
        The rows in the same order.
    """
    rows = []
    for i, parameter in enumerate(parameters):
        value, error = float(values[i]), float(np.sqrt(covariance[i, i])) if covariance[i, i] > 0 else np.nan
        z = value / error
        p_value = float(2.0 * stats.norm.sf(abs(z)))
        at_bound = parameter.at_bound(value)
        identifiable = bool(error < max(parameter.scale, abs(value)) and not unknown[i])
        low, high = max(intervals[i][0], parameter.lower), min(intervals[i][1], parameter.upper)
        if np.isnan(error) or not (identifiable or low < high):
            low = high = np.nan  # an interval without width would claim certainty
        rows.append(
            Estimate(
                name=parameter.name,
                term=parameter.name.partition(".")[0] if parameter.term else None,
                joint=parameter.joint,
                value=value,
                unit=parameter.unit,
                std_error=error,
                std_error_reference=float(np.sqrt(classical[i, i] / n)) if classical[i, i] > 0 else np.nan,
                ci99=(low, high),
                z=z,
                p_value=p_value,
                significant=p_value < ALPHA and identifiable and not at_bound,
                identifiable=identifiable,
                at_bound=at_bound,
                recording=parameter.recording,
            )
        )
    return rows


def estimates_from_errors(
    parameters: list[Parameter], values: FloatArray, errors: FloatArray
) -> list[Estimate]:
    """Make rows of values (P,) that are taken from elsewhere, with their standard errors (P,)."""
    covariance, reach = np.diag(np.asarray(errors, dtype=np.float64) ** 2), ALPHA_QUANTILE
    ends = [(float(v - reach * e), float(v + reach * e)) for v, e in zip(values, errors, strict=True)]
    return estimates(parameters, values, covariance, covariance, 1, np.zeros(len(values), dtype=bool), ends)


def with_min_error(row: Estimate, error: float) -> Estimate:
    """The row with a standard error of at least ``error``; interval and test follow from it."""
    if not error > (0.0 if np.isnan(row.std_error) else row.std_error):
        return row
    z = row.value / error
    p_value = float(2.0 * stats.norm.sf(abs(z)))
    ends = row.value - ALPHA_QUANTILE * error, row.value + ALPHA_QUANTILE * error
    significant = row.significant and p_value < ALPHA
    return replace(row, std_error=error, ci99=ends, z=z, p_value=p_value, significant=significant)


def with_wider_error(row: Estimate, error: float, bounds: tuple[float, float]) -> Estimate:
    """The row with a standard error of at least ``error``, and the hull of its interval and that error's.

    ``bounds``, a lower and an upper one, cut the interval.
    """
    wider = with_min_error(row, error)
    if wider is row:
        return row
    low = max(min(row.ci99[0], wider.ci99[0]), bounds[0])
    high = min(max(row.ci99[1], wider.ci99[1]), bounds[1])
    return replace(wider, ci99=(low, high))


def smallest_p_value(
    test: Callable[[FloatArray, slice], float], residuals: FloatArray, begins: Sequence[int] = (0,)
) -> float:
    """Test each channel in each recording, and combine the p values by Bonferroni's correction.

    Args:
        test: Gets a channel's residuals in one recording and the rows of that recording, returns a p value.
        residuals: (n, channels).
        begins: Rows at which recordings begin.
    """
    slices = recording_slices(begins, len(residuals))
    p_values = [test(column[rows], rows) for column in residuals.T for rows in slices]
    return min(1.0, len(p_values) * min(p_values))


def whiteness(residuals: FloatArray, lags: int = 20) -> float:
    """p value of Ljung and Box's test that residuals (n,) are white.

    Q = n(n + 2)·Σ ρ_k²/(n − k) over lags k = 1 … ``lags`` is χ² with as many degrees of freedom (Ljung and
    Box, Biometrika 65, 1978).
    """
    n = len(residuals)
    if n <= lags + 1 or not np.ptp(residuals) > 0.0:
        return 1.0
    squares = autocorrelation(residuals, lags)[1:] ** 2
    statistic = n * (n + 2.0) * float(np.sum(squares / (n - np.arange(1, lags + 1))))
    return float(stats.chi2.sf(statistic, lags))


def autocorrelation(values: FloatArray, lags: int) -> FloatArray:
    """Sample autocorrelation (lags + 1,) of values (n,) about their mean, from lag 0, with divisor n."""
    centred = values - np.mean(values)
    sums = [float(centred[: len(centred) - k] @ centred[k:]) for k in range(lags + 1)]
    return np.asarray(sums) / max(sums[0], 1e-300)


def input_crosscorrelation(residuals: FloatArray, inputs: FloatArray, lags: int = 20) -> float:
    """p value of the test that residuals (n,) are uncorrelated with the input (n,) up to ``lags`` samples.

    Both are filtered with an AR(1) of the residuals first, so that correlated noise raises no alarm. Then
    n·R² of a regression on the lagged inputs is χ² with as many degrees of freedom as they have rank.
    """
    n = len(residuals) - lags
    if n <= 2 * lags:
        return 1.0
    rho = float(residuals[1:] @ residuals[:-1]) / max(float(residuals @ residuals), 1e-300)
    r, u = residuals[1:] - rho * residuals[:-1], inputs[1:] - rho * inputs[:-1]
    lagged_inputs = np.column_stack([u[lags - k : len(u) - k] for k in range(lags)])
    lagged_inputs = lagged_inputs - lagged_inputs.mean(axis=0)
    target = r[lags:] - r[lags:].mean()
    left, singular, _ = np.linalg.svd(lagged_inputs, full_matrices=False)
    strong = singular > 1e-8 * max(singular[0], 1e-300)
    explained = float(np.sum((left[:, strong].T @ target) ** 2))
    statistic = len(target) * explained / max(float(target @ target), 1e-300)
    return float(stats.chi2.sf(statistic, int(np.sum(strong))))
