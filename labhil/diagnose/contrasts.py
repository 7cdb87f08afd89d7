"""Do parts of the data agree on the parameters? If not, by which factor are all standard errors too small?

Where a model lacks something its parameters compensate for it, in every regime and on other data in another
way. With estimates θ₁ and θ₂ of P parameters from two parts of the data and their covariances,

    S² = (θ₁ − θ₂)ᵀ (C₁ + C₂)⁻¹ (θ₁ − θ₂) / P,

which is about one where the model is complete. Parts are the halves of the samples in which a signal is low
and high, or near its middle and far from it, and the searched and the held-out data. Where two parts
contradict each other, all standard errors are multiplied by their S (Birge, Physical Review 40, 1932; the
scale factor of the Particle Data Group's averages; the test is Hausman's, Econometrica 46, 1978).

An effect that acts alike in all parts, as a friction that is missing at every speed, does not show.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats
from scipy.ndimage import uniform_filter1d

from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit_on_windows
from labhil.identify.continuation import settle_fit
from labhil.identify.fitted import Fitted
from labhil.identify.statistics import inverse_information
from labhil.identify.table import ParameterTable, table_of
from labhil.physics.record import Record
from labhil.signals import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Contrast:
    """The ``difference`` (P,) of two estimates of the same parameters, and its ``covariance`` (P, P)."""

    difference: FloatArray
    covariance: FloatArray

    @property
    def chi_square(self) -> tuple[float, int]:
        """χ² of the difference, and the number of parameters with a finite variance."""
        variance = np.diag(self.covariance)
        known = np.isfinite(variance) & (variance > 0.0)
        if not known.any():
            return 0.0, 0
        errors = np.sqrt(variance[known])
        correlation = self.covariance[np.ix_(known, known)] / np.outer(errors, errors)
        scaled = self.difference[known] / errors
        size = float(scaled @ np.linalg.pinv(correlation, hermitian=True) @ scaled)
        return size, int(known.sum())


def scale_factor(contrasts: Sequence[Contrast], *, alpha: float = 0.01) -> float:
    """Return the scale factor S of the two parts that contradict each other most.

    Args:
        contrasts: differences of estimates from parts of the data.
        alpha: level of the test that any two parts contradict each other, all contrasts together
            (Bonferroni).

    Returns:
        Factor of all standard errors, at least 1; 1 where no parts contradict each other.
    """
    sizes = [contrast.chi_square for contrast in contrasts]
    tests = [(float(stats.chi2.sf(size, dof)), size / dof) for size, dof in sizes if dof]
    if not tests:
        return 1.0
    p_value, mean_square = min(tests, key=lambda test: (test[0], -test[1]))
    return max(1.0, float(np.sqrt(mean_square))) if len(tests) * p_value < alpha else 1.0


def refit_on_held_out(data: Data, fitted: Fitted) -> Fitted | None:
    """Refit a model to the held-out data.

    Args:
        data: searched and held-out data.
        fitted: a model that was fitted to the searched data.

    Returns:
        The fit; None where some parameters belong to one recording.
    """
    if any(fitted.problem.model.parameters[place].recording is not None for place in fitted.problem.free):
        return None
    held_out = replace(
        data,
        model=fitted.problem.model,
        search=data.test,
        sigma=data.test_sigma,
        window=min(fitted.window, data.test.longest),
        held=fitted.held,
    )
    return settle_fit(refit_on_windows(held_out, fitted))


def contrast_with_held_out(fitted: Fitted, held_out_fit: Fitted, table: ParameterTable) -> Contrast:
    """Return the difference of the estimates from searched and from held-out data.

    Args:
        fitted: a model that was fitted to the searched data.
        held_out_fit: the same model fitted to the held-out data.
        table: the parameters of ``fitted`` with their covariance.

    Returns:
        The contrast of both.
    """
    free = fitted.problem.free
    return Contrast(
        fitted.theta[free] - held_out_fit.theta[free], table.covariance + table_of(held_out_fit).covariance
    )


def contrasts_of_halves(fitted: Fitted, table: ParameterTable) -> list[Contrast]:
    """Return the differences of the estimates from halves of the searched data in different regimes.

    Estimates of a half are one Gauss-Newton step from the fit.

    Args:
        fitted: a model that was fitted to the searched data.
        table: its parameters with covariance and projected slopes.

    Returns:
        A contrast for each way to divide the samples in which both halves determine all parameters.
    """
    size = np.linalg.norm(table.jacobian, axis=0)
    sensitive = size > 0.0
    slopes, residuals = table.jacobian[:, sensitive] / size[sensitive], fitted.solution.residuals
    variance = np.diag(inverse_information(slopes)) * fitted.noise**2
    robust = np.diag(table.covariance)[sensitive] * size[sensitive] ** 2
    error_factor = np.sqrt(np.maximum(robust / variance, 1.0)) * fitted.noise
    contrasts = []
    for half in _halves(fitted):
        estimates = [_estimate(slopes[rows], residuals[rows]) for rows in (half, ~half)]
        if all(estimate is not None for estimate in estimates):
            (first, first_covariance), (second, second_covariance) = (
                estimate for estimate in estimates if estimate is not None
            )
            covariance = (first_covariance + second_covariance) * np.outer(error_factor, error_factor)
            contrasts.append(Contrast(first - second, covariance))
    return contrasts


def _estimate(slopes: FloatArray, residuals: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Gauss-Newton step of the parameters on some rows alone, and its covariance in units of noise².

    None where these rows do not determine all parameters.
    """
    gram = slopes.T @ slopes
    eigenvalues = np.linalg.eigvalsh(gram)
    if not eigenvalues[0] > 1e-8 * eigenvalues[-1]:
        return None
    inverse: FloatArray = np.asarray(np.linalg.inv(gram), dtype=np.float64)
    return -inverse @ (slopes.T @ residuals), inverse


def _halves(fitted: Fitted, *, min_windows: int = 4) -> Iterator[BoolArray]:
    """Marks (N·c,) of one half of the rows: those with a high signal, and those far from its median.

    Rows are divided one by one and, from ``min_windows`` windows (two in a half), as whole windows: an effect
    in a window is in all of its errors.
    """
    problem = fitted.problem
    windows, n_outputs = problem.windows, len(problem.sigma)
    count = np.bincount(windows.owner)
    for signal in _regime_signals(problem.record).T:
        samples = signal[windows.rows]
        for values in (samples, np.abs(samples - np.median(samples))):
            window_mean = (np.bincount(windows.owner, values) / np.maximum(count, 1))[windows.owner]
            for split_by in (values,) if len(count) < min_windows else (values, window_mean):
                yield np.repeat(split_by > np.median(split_by), n_outputs)


def _regime_signals(record: Record, *, rate_samples: int = 7) -> FloatArray:
    """Signals (n, k) that distinguish regimes: time, inputs, outputs and the rates of outputs.

    An output is averaged over ``rate_samples`` before it is differentiated, so that its rate is more than
    noise.
    """
    rates = np.gradient(uniform_filter1d(record.outputs, rate_samples, axis=0), axis=0)
    signals = np.hstack([record.t[:, None], record.inputs, record.outputs, rates])
    return signals[:, np.ptp(signals, axis=0) > 0.0]
