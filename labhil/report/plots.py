"""What people compare, drawn: measurement and simulation, where the mismatch lives, before and after."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.diagnose import locate
from labhil.diagnose.answer import Curve, Diagnosis
from labhil.identify.score import Score
from labhil.physics.model import Record
from labhil.physics.terms import keyed
from labhil.report.figure import AFTER, BEFORE, MEASURED, figure_of, finish, save
from labhil.signals import FloatArray

FOR_THE_LEGEND = 0.2
"""Room above a curve, over its range: a formula is wide."""


def diagnosis_plot(diagnosis: Diagnosis, path: Path) -> None:
    """Write a page of four panels as PNG: simulation, errors, the missing effort, and errors as histogram.

    UsageError when the file cannot be written or its extension is no format of pictures.
    """
    save(diagnosis_figure(diagnosis), path)


def diagnosis_figure(diagnosis: Diagnosis) -> Figure:
    """The four panels as a figure."""
    figure = figure_of((11.0, 8.0))
    axes = figure.subplots(2, 2)
    j = _located(diagnosis)
    _draw_windows(axes[0, 0], diagnosis, j)
    _draw_errors(axes[0, 1], diagnosis, j)
    _draw_missing(axes[1, 0], diagnosis)
    _draw_histogram(axes[1, 1], diagnosis, j)
    return figure


def _located(diagnosis: Diagnosis) -> int:
    """Place of the output that is off by most; the first where nothing is located."""
    where = diagnosis.location
    if where is None:
        return 0
    channels = [(channel.channel, channel.joint) for channel in diagnosis.after.channels]
    return channels.index((where.channel, where.joint))


def broken(score: Score, values: FloatArray) -> FloatArray:
    """Values (N,) of scored rows with a gap where a new window begins, so that no line crosses it."""
    return np.asarray(np.where(np.r_[True, np.diff(score.window) > 0], np.nan, values))


def time_axis(axes: Axes, record: Record) -> str:
    """What a picture says of its time; borders between several recordings are drawn, with their numbers."""
    if len(record.begins) == 1:
        return "t, s"
    for begin, (first, _) in zip(record.begins, record.spans, strict=True):
        axes.axvline(record.t[first], color="k", lw=0.6, alpha=0.5)
        place = axes.get_xaxis_transform()
        axes.text(record.t[first], 1.0, f"@{begin.number}", transform=place, fontsize=7, va="top")
    return "t, s, one recording after another"


def channel_figure(diagnosis: Diagnosis, j: int) -> Figure:
    """Simulation and errors of output channel ``j`` as a figure: for rigs that have more than one."""
    figure = figure_of((11.0, 3.6))
    axes = figure.subplots(1, 2)
    _draw_windows(axes[0], diagnosis, j)
    _draw_errors(axes[1], diagnosis, j)
    return figure


def _draw_windows(axes: Axes, diagnosis: Diagnosis, j: int) -> None:
    record, rows = diagnosis.held_out, diagnosis.after.rows
    t, measured = record.t[rows], record.outputs[rows, j]
    channel = diagnosis.after.channels[j]
    axes.plot(t, broken(diagnosis.after, measured), color=MEASURED, lw=2.5, alpha=0.5, label="measured")
    for score, colour, label in _both(diagnosis, j):
        axes.plot(t, broken(score, measured + score.errors[:, j]), color=colour, lw=1.0, label=label)
    name = keyed(channel.channel, channel.joint)
    title = "Simulated windows on data the search never saw"
    finish(axes, title, time_axis(axes, record), f"{name}, {channel.unit}")


def _draw_errors(axes: Axes, diagnosis: Diagnosis, j: int) -> None:
    record = diagnosis.held_out
    channel = diagnosis.after.channels[j]
    for score, colour, label in _both(diagnosis, j):
        axes.plot(record.t[score.rows], broken(score, score.errors[:, j]), color=colour, lw=1.0, label=label)
    axes.axhspan(-channel.noise_floor, channel.noise_floor, color="k", alpha=0.12, label="noise floor")
    finish(axes, "Error", time_axis(axes, record), channel.unit)


def _draw_missing(axes: Axes, diagnosis: Diagnosis) -> None:
    """The effort of each missing term, against the coordinate along which the strongest is concentrated."""
    if not diagnosis.missing:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "nothing is missing", ha="center")
        return
    if diagnosis.curve is not None:
        _draw_curve(axes, diagnosis.curve)
        return
    seen = locate.HeldOut(diagnosis.held_out, diagnosis.before, diagnosis.after)
    terms = [keyed(item.term, item.joint) for item in diagnosis.missing]
    joint = diagnosis.location.joint if diagnosis.location is not None else None
    shares, regimes = locate.lived(diagnosis.final_fit, terms, seen, joint)
    term = next((term for term, found in regimes.items() if found), next(iter(shares)))
    units = shares[term].units
    over = [regime.coordinate for regime in regimes[term]]
    name = over[0] if over and over[0] in units else next(iter(units))
    for i, (key, share) in enumerate(shares.items()):
        largest = _shown_over(shares, key)
        told = f"{key}, up to {largest:.3g}" if len(shares) > 1 else key
        axes.scatter(
            share.coordinates[name], share.values / largest, s=6, color=f"C{i}", alpha=0.5, lw=0, label=told
        )
    for number, regime in enumerate(regimes[term]):
        label = f"where most of {term} lives" if number == 0 else None
        # a regime of its own force lies across the picture
        span, size = (axes.axvspan, 1.0) if name in over else (axes.axhspan, _shown_over(shares, term))
        span(regime.low / size, regime.high / size, color=BEFORE, alpha=0.15, label=label)
    effort = "missing effects, over their largest" if len(shares) > 1 else "missing effect, where it acts"
    finish(axes, "What the baseline leaves out", f"{name}, {units[name]}", effort)


def _shown_over(shares: Mapping[str, locate.Contribution], term: str) -> float:
    """What a term is drawn over: several are in several units and sizes, each over its own largest value."""
    return max(float(np.max(np.abs(shares[term].values))), 1e-300) if len(shares) > 1 else 1.0


def _draw_curve(axes: Axes, curve: Curve) -> None:
    """What no named term explains, with its band."""
    axes.fill_between(curve.x, curve.low, curve.high, color=AFTER, alpha=0.25, lw=0, label="99 % band")
    label = curve.formula or curve.acts.replace("_", " ")
    axes.plot(curve.x, curve.value, color=AFTER, lw=1.5, label=label)
    axes.axhline(0.0, color=MEASURED, lw=0.8)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + FOR_THE_LEGEND * (high - low))
    where = "" if curve.joint is None else f" on joint {curve.joint}"
    finish(axes, f"What no named effect explains{where}", f"{curve.depends_on}, {curve.x_unit}", curve.unit)


def _draw_histogram(axes: Axes, diagnosis: Diagnosis, j: int) -> None:
    channel = diagnosis.after.channels[j]
    spread = 4.0 * max(channel.rmse, channel.noise_floor)
    for score, colour, label in _both(diagnosis, j):
        clipped = np.clip(score.errors[:, j], -spread, spread)
        axes.hist(clipped, bins=61, range=(-spread, spread), color=colour, alpha=0.6, label=label)
    axes.locator_params(axis="x", nbins=5)
    finish(axes, "Errors (outliers at the edges)", f"error, {channel.unit}", "samples")


def _both(diagnosis: Diagnosis, j: int) -> list[tuple[Score, str, str]]:
    before, after = diagnosis.before, diagnosis.after
    unit = before.channels[j].unit
    return [
        (before, BEFORE, f"before: RMSE {before.channels[j].rmse:.3g} {unit}"),
        (after, AFTER, f"after: RMSE {after.channels[j].rmse:.3g} {unit}"),
    ]
