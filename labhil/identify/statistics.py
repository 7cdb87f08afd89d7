"""Statistics of estimates: standard errors, tests, intervals, and what the data cannot know.

The covariance does not assume white residuals. With the projected Jacobian J (states of the windows
taken out) and residuals r, both in units of noise,

    C = (JᵀJ)⁻¹ · S · (JᵀJ)⁻¹,   S = Γ₀ + Σ_l w_l·(Γ_l + Γ_lᵀ),   Γ_l = Σ_t J_t r_t r_{t−l} J_{t−l}ᵀ

with Bartlett's weights (Newey and West 1987) and Andrews' (1991) bandwidth, which lets the spread of the
residuals change with the regime but is biased low on short records; and, where it is larger, the same with
the autocovariance of an autoregressive model of each channel in the place of r_t r_{t−l}. Negative
correlation is not allowed to shrink a variance below the classical σ̂²(JᵀJ)⁻¹.
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
REACH = float(stats.norm.ppf(1.0 - 0.5 * ALPHA))
"""Standard errors on both sides of a value that an interval at that level has."""

FAINTEST = 1e-9

MOST_ORDERS = 10
FADED = 0.01
"""Share of the variance below which an autocovariance is left out."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter with what is known of it; ``ci99`` is the interval at 99 %, cut at the bounds.

    A value that was held, not estimated, has no error: ``std_error``, ``ci99``, ``z`` and ``p_value`` are
    NaN.
    ``std_error_reference`` is the reference text's own formula, √C_ii/√n of the classical covariance,
    kept for comparison with its tables only: its intervals are far too narrow.
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


def runs(begins: Sequence[int], n: int) -> list[slice]:
    """Rows of each recording among ``n`` samples, the recordings beginning at the rows ``begins``."""
    edges = [*begins, n]
    return [slice(a, b) for a, b in pairwise(edges)]


def robust_covariance(
    jacobian: FloatArray,
    residuals: FloatArray,
    dof: int,
    channels: int = 1,
    begins: Sequence[int] = (0,),
) -> FloatArray:
    """Covariance (P, P) of least-squares estimates whose residuals (N,) may be correlated in time.

    ``jacobian`` (N, P) is the projected one; ``dof`` the residual degrees of freedom. Rows are those of the
    ``channels`` of one sample after the other; recordings begin at the samples ``begins``, and nothing in
    one is correlated with anything in another.
    """
    n = len(residuals)
    inverse = inverse_information(jacobian)
    classical = inverse * float(residuals @ residuals) / dof
    # what counts in time are samples: their channels are added up
    scores = (jacobian * residuals[:, None]).reshape(n // channels, channels, -1).sum(axis=1)
    robust = inverse @ long_run_variance(scores, begins) @ inverse * (n / dof)
    modelled = inverse @ modelled_variance(jacobian, residuals, channels, begins) @ inverse * (n / dof)
    robust = _at_least(modelled, robust)
    floor, variances = np.diag(classical), np.diag(robust)
    lost = ~(variances > 1e-12 * floor)
    # rounding may leave nothing, or less, of a direction that the data do not know
    robust[lost, :] = robust[:, lost] = 0.0
    robust[lost, lost] = floor[lost]
    return _at_least(robust, classical)


def _at_least(covariance: FloatArray, floor: FloatArray) -> FloatArray:
    """A covariance (P, P) whose variances are raised, correlations kept, to those of ``floor`` (P, P)."""
    wanted = np.diag(floor)
    variances = np.maximum(np.diag(covariance), 1e-24 * wanted + 1e-300)
    shortfall = np.sqrt(np.maximum(1.0, wanted / variances))
    return np.asarray(covariance * np.outer(shortfall, shortfall))


def inverse_information(jacobian: FloatArray) -> FloatArray:
    """(JᵀJ)⁻¹ of a Jacobian (N, P) whose columns have about unit length.

    A direction that changes nothing gets a huge variance instead of none: slopes from differences are
    known to about 1e-7, so a singular value under 1e-9 of the largest one counts as that much.
    """
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=False)
    singular = np.maximum(singular, FAINTEST * max(float(singular.max(initial=0.0)), 1e-130))
    return np.asarray((rows.T / singular**2) @ rows)


def nonzero(values: FloatArray, covariance: FloatArray, looks: int = 1) -> bool:
    """Whether values (k,), all together, differ from zero: Wald's test at 1 %.

    They are the best of so many ``looks``. Values with an infinite variance in ``covariance`` (k, k) do not
    count.
    """
    known = np.flatnonzero(np.isfinite(np.diag(covariance)))
    if not len(known):
        return False
    inverse = np.linalg.pinv(covariance[np.ix_(known, known)], hermitian=True)
    return bool(values[known] @ inverse @ values[known] > stats.chi2.isf(ALPHA / looks, len(known)))


def lagged_product(rows: FloatArray, lag: int, begins: Sequence[int] = (0,)) -> FloatArray:
    """Σ_t row_t·row_{t−lag}ᵀ of rows (n, P), both from the same recording, (P, P)."""
    parts = [rows[run] for run in runs(begins, len(rows))]
    return np.asarray(sum(part[lag:].T @ part[: len(part) - lag] for part in parts if len(part) > lag))


def neighbours(rows: FloatArray, begins: Sequence[int] = (0,)) -> FloatArray:
    """Each of some rows (n, …) times the one before it in the same recording, (n − recordings, …)."""
    return np.concatenate([rows[run][1:] * rows[run][:-1] for run in runs(begins, len(rows))])


def long_run_variance(scores: FloatArray, begins: Sequence[int] = (0,)) -> FloatArray:
    """n times the long-run covariance of the mean of rows (n, P), Bartlett kernel."""
    total = scores.T @ scores
    reach = bandwidth(scores, begins)
    for lag in range(1, reach + 1):
        weight = 1.0 - lag / (reach + 1)
        cross = lagged_product(scores, lag, begins)
        total = total + weight * (cross + cross.T)
    return np.asarray(total)


def modelled_variance(
    jacobian: FloatArray, residuals: FloatArray, channels: int, begins: Sequence[int] = (0,)
) -> FloatArray:
    """Covariance (P, P) of JᵀR where each channel's residuals are an autoregression of themselves.

    Its order, up to 10, is that of the least AIC; channels are taken as independent.
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


def autocovariance(residuals: FloatArray, begins: Sequence[int] = (0,)) -> FloatArray:
    """Autocovariances (lags + 1,) of an autoregression fitted to residuals (n,), as far as they matter."""
    n = len(residuals)
    orders = min(MOST_ORDERS, n // 10)
    power = float(residuals @ residuals) / n
    if power <= 0.0 or orders < 1:
        return np.array([power])
    measured = np.array([float(lagged_product(residuals, lag, begins)) for lag in range(orders + 1)]) / n
    best, weights, score = 0, np.empty(0), n * np.log(power)
    for order in range(1, orders + 1):
        weights_tried = solve_toeplitz(measured[:order], measured[1 : order + 1])
        innovation = measured[0] - float(weights_tried @ measured[1 : order + 1])
        if innovation > 0.0 and n * np.log(innovation) + 2.0 * order < score:
            best, weights, score = order, weights_tried, n * np.log(innovation) + 2.0 * order
    covariances = list(measured[: best + 1])
    while best and len(covariances) < n // 4 and max(abs(x) for x in covariances[-best:]) > FADED * power:
        covariances.append(float(weights @ covariances[: -best - 1 : -1]))
    return np.array(covariances)


def bandwidth(scores: FloatArray, begins: Sequence[int] = (0,)) -> int:
    """Andrews' automatic bandwidth for Bartlett's kernel, from an AR(1) of each column."""
    n = len(scores)
    if n < 8:
        return 0
    scores = scores[:, np.any(scores, axis=0)]
    power = np.mean(scores**2, axis=0)
    rho = np.mean(neighbours(scores, begins), axis=0) / np.maximum(power, 1e-300)
    rho = np.clip(rho, -0.97, 0.97)
    # columns are weighted to have the same power, so only their correlations count
    share = (1.0 - rho**2) ** 2
    top = float(np.sum(4.0 * rho**2 * share / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)))
    bottom = float(np.sum(share / (1.0 - rho) ** 4))
    reach = 1.1447 * (top / max(bottom, 1e-300) * n) ** (1.0 / 3.0)
    return int(min(np.ceil(reach), n // 4))


def estimates(
    parameters: list[Parameter],
    values: FloatArray,
    covariance: FloatArray,
    classical: FloatArray,
    n: int,
    unknown: np.ndarray,
    intervals: Sequence[tuple[float, float]],
) -> list[Estimate]:
    """Put values, robust ``covariance`` and ``classical`` covariance (P, P) into a row per parameter.

    ``unknown`` (P,) marks parameters that take part in a direction which the data do not know;
    ``intervals`` (P,) are cut at the bounds here. A variance of zero marks a value that was held.
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
            low = high = np.nan  # nothing is known of it: an interval without width would claim certainty
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


def stated_estimates(parameters: list[Parameter], values: FloatArray, errors: FloatArray) -> list[Estimate]:
    """Rows of values (P,) that are taken from elsewhere, with their standard errors (P,)."""
    spread = np.diag(np.asarray(errors, dtype=np.float64) ** 2)
    ends = [(float(v - REACH * e), float(v + REACH * e)) for v, e in zip(values, errors, strict=True)]
    return estimates(parameters, values, spread, spread, 1, np.zeros(len(values), dtype=bool), ends)


def with_error(row: Estimate, error: float) -> Estimate:
    """The row with a standard error of at least this."""
    if not error > (0.0 if np.isnan(row.std_error) else row.std_error):
        return row
    z = row.value / error
    p_value = float(2.0 * stats.norm.sf(abs(z)))
    ends = row.value - REACH * error, row.value + REACH * error
    sure = row.significant and p_value < ALPHA
    return replace(row, std_error=error, ci99=ends, z=z, p_value=p_value, significant=sure)


def with_wider_error(row: Estimate, error: float, bounds: tuple[float, float]) -> Estimate:
    """The row with a larger standard error; its interval becomes the hull with what that error gives.

    ``bounds`` cut the interval.
    """
    wider = with_error(row, error)
    if wider is row:
        return row
    low = max(min(row.ci99[0], wider.ci99[0]), bounds[0])
    high = min(max(row.ci99[1], wider.ci99[1]), bounds[1])
    return replace(wider, ci99=(low, high))


def of_channels(
    test: Callable[[FloatArray, slice], float], residuals: FloatArray, begins: Sequence[int] = (0,)
) -> float:
    """p value of a test of each channel of residuals (n, channels) in each recording: the least times all.

    The test is given a channel's residuals in one recording, and which rows these are.
    """
    p_values = [test(column[run], run) for column in residuals.T for run in runs(begins, len(residuals))]
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
    """Sample autocorrelation (lags + 1,) of values (n,) about their mean, from lag 0; all sums over n."""
    centred = values - np.mean(values)
    sums = [float(centred[: len(centred) - k] @ centred[k:]) for k in range(lags + 1)]
    return np.asarray(sums) / max(sums[0], 1e-300)


def input_crosscorrelation(residuals: FloatArray, inputs: FloatArray, lags: int = 20) -> float:
    """p value of the test that residuals (n,) are uncorrelated with the input (n,) up to ``lags`` samples.

    Both are filtered with the residuals' own AR(1) first, so that correlated noise is no alarm; then
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
