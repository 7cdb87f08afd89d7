"""A fit as figures: simulation and measurement, errors, and the autocorrelation of the residuals."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.identify.fit import Fit
from labhil.identify.score import ChannelScore
from labhil.identify.statistics import autocorrelation, recording_slices
from labhil.physics.record import Record
from labhil.physics.terms import keyed
from labhil.report.figure import AFTER, MEASURED, figure_of, finish
from labhil.report.plots import time_axis, with_gaps
from labhil.signals import FloatArray


def fit_figure(fit: Fit, record: Record, columns: int = 4, *, max_outputs: int = 6) -> Figure:
    """Draw four panels per output: simulation, errors, their histogram, and the residuals' autocorrelation.

    The histogram has the normal curve of the same spread, the autocorrelation the 99 % band of white noise.

    Args:
        fit: The fit.
        record: The record of the test score; without one, of the training score.
        columns: Panels in a row: 4, 2 or 1.
        max_outputs: Outputs that are drawn; an arm has many.
    """
    score = fit.test or fit.train
    shown = score.channels[:max_outputs]
    height = len(shown) * 4 // columns
    figure = figure_of((3.75 * columns if columns == 4 else 5.5 * columns, 3.4 * height))
    rows = figure.subplots(height, columns, squeeze=False).reshape(len(shown), 4)
    for j, channel in enumerate(shown):
        draw_simulation(rows[j, 0], fit, record, j)
        draw_errors(rows[j, 1], fit, record, j)
        _draw_histogram(rows[j, 2], score.errors[:, j], channel)
        draw_autocorrelation(rows[j, 3], fit, j)
    return figure


def _name(channel: ChannelScore) -> str:
    return f"{keyed(channel.channel, channel.joint)}, {channel.unit}"


def draw_simulation(axes: Axes, fit: Fit, record: Record, j: int) -> None:
    """Draw the scored simulation of output ``j`` with the measurement."""
    score = fit.test or fit.train
    channel = score.channels[j]
    t, measured = record.t[score.rows], record.outputs[score.rows, j]
    axes.plot(t, with_gaps(score, measured), color=MEASURED, lw=2.5, alpha=0.5, label="measured")
    simulated = with_gaps(score, measured + score.errors[:, j])
    axes.plot(t, simulated, color=AFTER, lw=1.0, label=f"model, R² {100 * channel.r2:.2f} %")
    finish(axes, "Model and measurement", time_axis(axes, record), _name(channel))


def draw_errors(axes: Axes, fit: Fit, record: Record, j: int) -> None:
    """Draw the errors of output ``j`` over time, with the noise floor."""
    score = fit.test or fit.train
    channel = score.channels[j]
    axes.plot(record.t[score.rows], with_gaps(score, score.errors[:, j]), color=AFTER, lw=0.8)
    floor = channel.noise_floor
    axes.axhspan(-floor, floor, color="k", alpha=0.12, label="noise floor")
    finish(axes, f"Error, RMSE {channel.rmse:.3g} {channel.unit}", time_axis(axes, record), channel.unit)


def _draw_histogram(axes: Axes, errors: FloatArray, channel: ChannelScore) -> None:
    spread = 4.5 * max(float(np.std(errors)), 1e-300)
    axes.hist(errors, bins=61, range=(-spread, spread), color=AFTER, alpha=0.6, density=True, label="errors")
    x = np.linspace(-spread, spread, 200)
    sigma = spread / 4.5
    density = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
    axes.plot(x, density, color=MEASURED, lw=1.2, label="normal, same spread")
    axes.locator_params(axis="x", nbins=5)
    finish(axes, "Errors, distribution", channel.unit, "density")


def draw_autocorrelation(axes: Axes, fit: Fit, j: int, *, max_lags: int = 60) -> None:
    """Draw the autocorrelation of the fitted residuals of output ``j``, averaged over the recordings.

    Args:
        axes: Where to draw.
        fit: The fit.
        j: Index of the output.
        max_lags: Largest lag, in samples; at most a third of the shortest recording.
    """
    slices = recording_slices(fit.fitted.problem.begins, len(fit.residuals))
    residuals = [fit.residuals[run, j] for run in slices]
    lengths = [len(series) for series in residuals]
    lags = min(max_lags, max(1, min(lengths) // 3))
    correlation = np.average([autocorrelation(series, lags) for series in residuals], axis=0, weights=lengths)
    band = 2.576 / np.sqrt(sum(lengths))
    axes.vlines(np.arange(1, lags + 1), 0.0, correlation[1:], color=AFTER, lw=1.5)
    axes.axhspan(-band, band, color="k", alpha=0.12, label="white noise, 99 %")
    axes.axhline(0.0, color="k", lw=0.6)
    axes.set_ylim(min(-0.2, 1.1 * float(correlation[1:].min())), max(0.2, 1.1 * float(correlation[1:].max())))
    finish(axes, "Residuals, autocorrelation", "lag, samples", "")
