"""Do parts of the data agree on the values? By how much all errors are too small, if not.

A model that lacks something has its parameters make up for that, in every regime and on other data in another
way. With estimates θ₁ and θ₂ of P parameters from two parts of the data and their covariances,

    S² = (θ₁ − θ₂)ᵀ (C₁ + C₂)⁻¹ (θ₁ − θ₂) / P,

which is about one where the model is complete. Parts are the halves of the samples in which a signal is low
and high, or near its middle and far from it, and the searched and the held-out data. Where two parts
contradict each other, all standard errors are multiplied by their S (Birge, Physical Review 40, 1932; the
scale factor of the Particle Data Group's averages; the test is Hausman's, Econometrica 46, 1978).

What all parts have in common, as a friction that is missing at every speed alike, stays unseen.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats
from scipy.ndimage import uniform_filter1d

from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit_on_windows
from labhil.identify.fitted import Fitted
from labhil.identify.statistics import inverse_information
from labhil.identify.table import ParameterTable, table_of
from labhil.physics.model import Record
from labhil.signals import BoolArray, FloatArray

LEVEL = 0.01
"""Of the test that two parts of the data contradict each other, all that are compared together."""

FEWEST = 4
"""Windows from which whole windows are compared, two in a half."""

SMOOTHED = 7
"""Samples over which an output's rate is averaged, so that it is more than noise."""


@dataclass(frozen=True, slots=True)
class Contrast:
    """The ``difference`` (P,) of two estimates of the same parameters, and its ``covariance`` (P, P)."""

    difference: FloatArray
    covariance: FloatArray

    @property
    def chi_square(self) -> tuple[float, int]:
        """Its size in units of its covariance, and of how many parameters anything is known."""
        variance = np.diag(self.covariance)
        known = np.isfinite(variance) & (variance > 0.0)
        if not known.any():
            return 0.0, 0
        errors = np.sqrt(variance[known])
        correlation = self.covariance[np.ix_(known, known)] / np.outer(errors, errors)
        scaled = self.difference[known] / errors
        size = float(scaled @ np.linalg.pinv(correlation, hermitian=True) @ scaled)
        return size, int(known.sum())


def scale_factor(contrasts: Sequence[Contrast]) -> float:
    """S of the two parts that contradict each other most; 1 where none do.

    Args:
        contrasts: what was compared.

    Returns:
        The factor of all standard errors, at least 1.
    """
    sizes = [contrast.chi_square for contrast in contrasts]
    tests = [(float(stats.chi2.sf(size, dof)), size / dof) for size, dof in sizes if dof]
    if not tests:
        return 1.0
    p_value, mean_square = min(tests, key=lambda test: (test[0], -test[1]))
    return max(1.0, float(np.sqrt(mean_square))) if len(tests) * p_value < LEVEL else 1.0


def on_held_out(data: Data, fitted: Fitted) -> Fitted | None:
    """Refit a model to the held-out data; None where some parameters belong to one recording."""
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
    return refit_on_windows(held_out, fitted)


def between_recordings(fitted: Fitted, held_out_fit: Fitted, table: ParameterTable) -> Contrast:
    """What searched and held-out data say of the same parameters.

    Args:
        fitted: a model that was fitted to the searched data.
        held_out_fit: the same on the held-out ones.
        table: the parameters of the first with their covariance.

    Returns:
        The contrast of both.
    """
    free = fitted.problem.free
    return Contrast(
        fitted.theta[free] - held_out_fit.theta[free], table.covariance + table_of(held_out_fit).covariance
    )


def between_parts(fitted: Fitted, table: ParameterTable) -> list[Contrast]:
    """What the halves of the searched data in different regimes say, by the slopes of the fit.

    Args:
        fitted: a model that was fitted to them.
        table: its parameters with covariance and projected slopes.

    Returns:
        A contrast for each way to cut the samples in two of which both halves know all parameters.
    """
    size = np.linalg.norm(table.jacobian, axis=0)
    sensitive = size > 0.0
    slopes, residuals = table.jacobian[:, sensitive] / size[sensitive], fitted.solution.residuals
    variance = np.diag(inverse_information(slopes)) * fitted.noise**2
    robust = np.diag(table.covariance)[sensitive] * size[sensitive] ** 2
    larger = np.sqrt(np.maximum(robust / variance, 1.0)) * fitted.noise
    contrasts = []
    for half in _halves(fitted):
        estimates = [_estimate(slopes[rows], residuals[rows]) for rows in (half, ~half)]
        if all(estimate is not None for estimate in estimates):
            (first, first_covariance), (second, second_covariance) = (
                estimate for estimate in estimates if estimate is not None
            )
            contrasts.append(
                Contrast(first - second, (first_covariance + second_covariance) * np.outer(larger, larger))
            )
    return contrasts


def _estimate(slopes: FloatArray, residuals: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Where some rows alone would have the parameters, and their covariance in noise's units.

    None where these rows do not know all of them.
    """
    gram = slopes.T @ slopes
    strengths = np.linalg.eigvalsh(gram)
    if not strengths[0] > 1e-8 * strengths[-1]:
        return None
    inverse: FloatArray = np.asarray(np.linalg.inv(gram), dtype=np.float64)
    return -inverse @ (slopes.T @ residuals), inverse


def _halves(fitted: Fitted) -> Iterator[BoolArray]:
    """Marks (N·c,) of one half of the rows: of each signal the high ones, and those far from its middle.

    Rows one by one, and windows as wholes: what acted in a window is in all of its errors.
    """
    problem = fitted.problem
    windows, outputs = problem.windows, len(problem.sigma)
    count = np.bincount(windows.owner)
    for signal in _moving(problem.record).T:
        samples = signal[windows.rows]
        for values in (samples, np.abs(samples - np.median(samples))):
            of_window = (np.bincount(windows.owner, values) / np.maximum(count, 1))[windows.owner]
            for split_by in (values,) if len(count) < FEWEST else (values, of_window):
                yield np.repeat(split_by > np.median(split_by), outputs)


def _moving(record: Record) -> FloatArray:
    """Signals (n, k) that distinguish regimes: time, inputs, outputs and their rates."""
    rates = np.gradient(uniform_filter1d(record.outputs, SMOOTHED, axis=0), axis=0)
    signals = np.hstack([record.t[:, None], record.inputs, record.outputs, rates])
    return signals[:, np.ptp(signals, axis=0) > 0.0]
