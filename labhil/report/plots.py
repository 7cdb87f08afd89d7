"""A diagnosis as figures: simulation before and after, errors, and each missing effect."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.diagnose import locate
from labhil.diagnose.answer import Curve, Diagnosis
from labhil.identify.score import Score
from labhil.physics.model import Metric
from labhil.physics.record import Record
from labhil.physics.terms import keyed
from labhil.report.figure import AFTER, BEFORE, MEASURED, figure_of, finish
from labhil.signals import FloatArray

Panel = Callable[[Axes], None]
"""Draws one panel."""

LEGEND_ROOM, WIDEST = 0.3, 36
"""Room above a curve, over its range, and characters in a line of its formula."""


def diagnosis_figure(diagnosis: Diagnosis) -> Figure:
    """Draw a diagnosis: simulation and errors above, each missing effect and a histogram below.

    Args:
        diagnosis: The diagnosis, with its held-out data.
    """
    j = worst_output(diagnosis)
    below: list[Panel] = [*_effect_panels(diagnosis), partial(_draw_histogram, diagnosis=diagnosis, j=j)]
    columns = 2 if len(below) in (2, 4) else 3
    rows = 1 + math.ceil(len(below) / columns)
    figure = figure_of((11.0, 4.0 * rows))
    grid = figure.add_gridspec(rows, 6)
    draw_windows(figure.add_subplot(grid[0, :3]), diagnosis, j)
    draw_errors(figure.add_subplot(grid[0, 3:]), diagnosis, j)
    wide = 6 // columns
    for i, draw in enumerate(below):
        row, column = divmod(i, columns)
        draw(figure.add_subplot(grid[1 + row, wide * column : wide * (column + 1)]))
    return figure


def worst_output(diagnosis: Diagnosis) -> int:
    """Return the index of the output with the largest mismatch; 0 where none is located."""
    location = diagnosis.location
    if location is None:
        return 0
    channels = [(channel.channel, channel.joint) for channel in diagnosis.after.channels]
    return channels.index((location.channel, location.joint))


def with_gaps(score: Score, values: FloatArray) -> FloatArray:
    """Put a NaN where a new window begins, so that no line crosses it.

    Args:
        score: The score, whose rows these are.
        values: (N,), a value for each scored row.

    Returns:
        (N,)
    """
    return np.asarray(np.where(np.r_[True, np.diff(score.window) > 0], np.nan, values))


def time_axis(axes: Axes, record: Record) -> str:
    """Draw the borders between recordings, and return the label of the time axis.

    Args:
        axes: Where to draw.
        record: One or several recordings, one after another on the time axis.
    """
    if len(record.begins) == 1:
        return "t, s"
    for begin, (first, _) in zip(record.begins, record.spans, strict=True):
        axes.axvline(record.t[first], color="k", lw=0.6, alpha=0.5)
        transform = axes.get_xaxis_transform()
        axes.text(record.t[first], 1.0, f"@{begin.number}", transform=transform, fontsize=7, va="top")
    return "t, s, one recording after another"


def channel_figure(diagnosis: Diagnosis, j: int) -> Figure:
    """Draw simulation and errors of output ``j``, for rigs that have several."""
    figure = figure_of((11.0, 3.6))
    axes = figure.subplots(1, 2)
    draw_windows(axes[0], diagnosis, j)
    draw_errors(axes[1], diagnosis, j)
    return figure


def draw_windows(axes: Axes, diagnosis: Diagnosis, j: int) -> None:
    """Draw output ``j`` as measured, and as simulated before and after."""
    record, rows = diagnosis.held_out, diagnosis.after.rows
    t, measured = record.t[rows], record.outputs[rows, j]
    channel = diagnosis.after.channels[j]
    axes.plot(t, with_gaps(diagnosis.after, measured), color=MEASURED, lw=2.5, alpha=0.5, label="measured")
    for score, colour, label in _before_and_after(diagnosis, j):
        axes.plot(t, with_gaps(score, measured + score.errors[:, j]), color=colour, lw=1.0, label=label)
    name = keyed(channel.channel, channel.joint)
    inverse = diagnosis.after.metric is Metric.INVERSE_DYNAMICS
    what = "Inverse dynamics" if inverse else "Simulated windows"
    finish(axes, f"{what} on data the search never saw", time_axis(axes, record), f"{name}, {channel.unit}")


def draw_errors(axes: Axes, diagnosis: Diagnosis, j: int) -> None:
    """Draw the errors of output ``j`` before and after, with the noise floor."""
    record = diagnosis.held_out
    channel = diagnosis.after.channels[j]
    for score, colour, label in _before_and_after(diagnosis, j):
        axes.plot(
            record.t[score.rows], with_gaps(score, score.errors[:, j]), color=colour, lw=1.0, label=label
        )
    axes.axhspan(-channel.noise_floor, channel.noise_floor, color="k", alpha=0.12, label="noise floor")
    finish(axes, "Error", time_axis(axes, record), channel.unit)


def _effect_panels(diagnosis: Diagnosis) -> list[Panel]:
    """One panel for each missing term that has a name, and for each nonparametric curve."""
    if not diagnosis.missing:
        return [_draw_nothing]
    curves = [curve for curve in (diagnosis.curve, *diagnosis.further_curves) if curve is not None]
    panels: list[Panel] = [partial(_draw_curve, curve=curve) for curve in curves]
    named = diagnosis.named
    if not named:
        return panels
    shares, regimes = _contributions(diagnosis)
    return [partial(_draw_effect, share=shares[term], regimes=regimes[term]) for term in named] + panels


def _contributions(
    diagnosis: Diagnosis,
) -> tuple[dict[str, locate.Contribution], dict[str, tuple[locate.Regime, ...]]]:
    """The contribution of each missing term to held-out data, and the regimes where it matters."""
    held_out = locate.HeldOut(diagnosis.held_out, diagnosis.before, diagnosis.after)
    joint = diagnosis.location.joint if diagnosis.location is not None else None
    return locate.locate_terms(diagnosis.final_fit, diagnosis.named, held_out, joint)


def draw_named_effect(axes: Axes, diagnosis: Diagnosis, term: str) -> None:
    """Draw the force of one missing term over the coordinate that shows it best.

    Args:
        axes: Where to draw.
        diagnosis: The diagnosis.
        term: Key of the term, such as ``spring_force``.
    """
    shares, regimes = _contributions(diagnosis)
    _draw_effect(axes, shares[term], regimes[term])


def _draw_nothing(axes: Axes) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, "nothing is missing", ha="center")


def _draw_effect(axes: Axes, share: locate.Contribution, regimes: Sequence[locate.Regime]) -> None:
    """Draw the force of a term over the coordinate that reveals it."""
    coordinate = share.abscissa(regimes)
    axes.scatter(coordinate.x, share.values, s=6, color=AFTER, alpha=0.5, lw=0)
    # regimes of other coordinates are not shown; a regime of the term itself is a horizontal band
    shown = [regime for regime in regimes if regime.coordinate in (coordinate.name, share.term)]
    for number, regime in enumerate(shown):
        span = axes.axvspan if regime.coordinate == coordinate.name else axes.axhspan
        label = "where it matters most" if number == 0 else None
        span(regime.low, regime.high, color=BEFORE, alpha=0.15, label=label)
    y_label = f"contribution, {share.unit}" if share.unit else "contribution"
    finish(axes, f"Left out: {share.term}", coordinate.label, y_label)


def _draw_curve(axes: Axes, curve: Curve) -> None:
    """Draw a nonparametric curve with its band."""
    axes.fill_between(curve.x, curve.low, curve.high, color=AFTER, alpha=0.25, lw=0, label="99 % band")
    label = textwrap.fill(curve.formula or curve.acts.replace("_", " "), WIDEST)
    axes.plot(curve.x, curve.value, color=AFTER, lw=1.5, label=label)
    axes.axhline(0.0, color=MEASURED, lw=0.8)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + LEGEND_ROOM * (high - low))
    where = "" if curve.joint is None else f" on joint {curve.joint}"
    finish(axes, f"Unexplained by named effects{where}", f"{curve.depends_on}, {curve.x_unit}", curve.unit)


def _draw_histogram(axes: Axes, diagnosis: Diagnosis, j: int) -> None:
    channel = diagnosis.after.channels[j]
    spread = 4.0 * max(channel.rmse, channel.noise_floor)
    for score, colour, label in _before_and_after(diagnosis, j):
        clipped = np.clip(score.errors[:, j], -spread, spread)
        axes.hist(clipped, bins=61, range=(-spread, spread), color=colour, alpha=0.6, label=label)
    axes.locator_params(axis="x", nbins=5)
    finish(axes, "Errors (outliers at the edges)", f"error, {channel.unit}", "samples")


def _before_and_after(diagnosis: Diagnosis, j: int) -> list[tuple[Score, str, str]]:
    before, after = diagnosis.before, diagnosis.after
    unit = before.channels[j].unit
    return [
        (before, BEFORE, f"before: RMSE {before.channels[j].rmse:.3g} {unit}"),
        (after, AFTER, f"after: RMSE {after.channels[j].rmse:.3g} {unit}"),
    ]
