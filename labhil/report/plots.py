"""What people compare, drawn: measurement and simulation, where the mismatch lives, before and after."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.diagnose import locate
from labhil.diagnose.answer import Curve, Diagnosis
from labhil.identify.score import Score
from labhil.physics.model import Metric, Record
from labhil.physics.terms import keyed
from labhil.report.figure import AFTER, BEFORE, MEASURED, figure_of, finish, save
from labhil.signals import FloatArray

Panel = Callable[[Axes], None]
"""Draws one panel."""

LEGEND_ROOM, WIDEST = 0.3, 36
"""Room above a curve, over its range, and characters in a line of its formula."""


def diagnosis_plot(diagnosis: Diagnosis, path: Path) -> None:
    """Write a page of panels as PNG: simulation, errors, each missing effect, and errors as histogram.

    UsageError when the file cannot be written or its extension is no format of pictures.
    """
    save(diagnosis_figure(diagnosis), path)


def diagnosis_figure(diagnosis: Diagnosis) -> Figure:
    """The panels as a figure: two above, and below them one for each effect and the histogram."""
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
    """Index of the output with the largest mismatch; 0 where none is located."""
    location = diagnosis.location
    if location is None:
        return 0
    channels = [(channel.channel, channel.joint) for channel in diagnosis.after.channels]
    return channels.index((location.channel, location.joint))


def with_gaps(score: Score, values: FloatArray) -> FloatArray:
    """Values (N,) of scored rows with a gap where a new window begins, so that no line crosses it."""
    return np.asarray(np.where(np.r_[True, np.diff(score.window) > 0], np.nan, values))


def time_axis(axes: Axes, record: Record) -> str:
    """Label of the time axis; borders between several recordings are drawn, with their numbers."""
    if len(record.begins) == 1:
        return "t, s"
    for begin, (first, _) in zip(record.begins, record.spans, strict=True):
        axes.axvline(record.t[first], color="k", lw=0.6, alpha=0.5)
        transform = axes.get_xaxis_transform()
        axes.text(record.t[first], 1.0, f"@{begin.number}", transform=transform, fontsize=7, va="top")
    return "t, s, one recording after another"


def channel_figure(diagnosis: Diagnosis, j: int) -> Figure:
    """Simulation and errors of output channel ``j`` as a figure: for rigs that have more than one."""
    figure = figure_of((11.0, 3.6))
    axes = figure.subplots(1, 2)
    draw_windows(axes[0], diagnosis, j)
    draw_errors(axes[1], diagnosis, j)
    return figure


def draw_windows(axes: Axes, diagnosis: Diagnosis, j: int) -> None:
    """Output ``j`` as measured, and as simulated before and after."""
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
    """The errors of output ``j`` before and after, with the noise floor."""
    record = diagnosis.held_out
    channel = diagnosis.after.channels[j]
    for score, colour, label in _before_and_after(diagnosis, j):
        axes.plot(
            record.t[score.rows], with_gaps(score, score.errors[:, j]), color=colour, lw=1.0, label=label
        )
    axes.axhspan(-channel.noise_floor, channel.noise_floor, color="k", alpha=0.12, label="noise floor")
    finish(axes, "Error", time_axis(axes, record), channel.unit)


def _effect_panels(diagnosis: Diagnosis) -> list[Panel]:
    """A panel for each effect that has a name, and for each curve of what has none."""
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
    """What each effect contributes to held-out data, and the regimes where it matters."""
    held_out = locate.HeldOut(diagnosis.held_out, diagnosis.before, diagnosis.after)
    joint = diagnosis.location.joint if diagnosis.location is not None else None
    return locate.locate_terms(diagnosis.final_fit, diagnosis.named, held_out, joint)


def draw_named_effect(axes: Axes, diagnosis: Diagnosis, term: str) -> None:
    """What the effect with this key adds, over the coordinate where it shows best."""
    shares, regimes = _contributions(diagnosis)
    _draw_effect(axes, shares[term], regimes[term])


def _draw_nothing(axes: Axes) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, "nothing is missing", ha="center")


def _draw_effect(axes: Axes, share: locate.Contribution, regimes: Sequence[locate.Regime]) -> None:
    """What an effect adds, against the coordinate that reveals it."""
    coordinate = share.abscissa(regimes)
    axes.scatter(coordinate.x, share.values, s=6, color=AFTER, alpha=0.5, lw=0)
    # a regime of another coordinate is not in the picture; one of its own force lies across it
    shown = [regime for regime in regimes if regime.coordinate in (coordinate.name, share.term)]
    for number, regime in enumerate(shown):
        span = axes.axvspan if regime.coordinate == coordinate.name else axes.axhspan
        label = "where most of it lives" if number == 0 else None
        span(regime.low, regime.high, color=BEFORE, alpha=0.15, label=label)
    generalised_force = f"what it adds, {share.unit}" if share.unit else "what it adds"
    finish(axes, f"Left out: {share.term}", coordinate.label, generalised_force)


def _draw_curve(axes: Axes, curve: Curve) -> None:
    """What no named term explains, with its band."""
    axes.fill_between(curve.x, curve.low, curve.high, color=AFTER, alpha=0.25, lw=0, label="99 % band")
    label = textwrap.fill(curve.formula or curve.acts.replace("_", " "), WIDEST)
    axes.plot(curve.x, curve.value, color=AFTER, lw=1.5, label=label)
    axes.axhline(0.0, color=MEASURED, lw=0.8)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + LEGEND_ROOM * (high - low))
    where = "" if curve.joint is None else f" on joint {curve.joint}"
    finish(axes, f"What no named effect explains{where}", f"{curve.depends_on}, {curve.x_unit}", curve.unit)


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
