"""Signals of a recording as pictures of few points, by the extremes of each interval of time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.recording.recording import StreamData
from labhil.report.figure import figure_of, finish
from labhil.report.html.element import Markup
from labhil.report.html.picture import Album, label
from labhil.signals import Direction, FloatArray, Hold, IntArray, Signal

INTERVALS = 900
"""Intervals of time in a picture: about as many as a page has pixels."""

COLOURS = ("#1f5f8b", "#c8553d", "#2a7f62", "#8a5a00", "#7c3a85", "#57606a")
LEFT, RIGHT = 0.09, 0.985
"""Where axes begin and end, so that all pictures of a page have one time axis."""


def signal_picture(album: Album, data: StreamData, signal: Signal) -> Markup:
    """Draw one signal over time, with a line for each column of a vector."""
    about = f" ({signal.description})" if signal.description else ""
    caption = f"{signal.name}{about}, {signal.direction.value} of /{data.device}/{data.stream.name}."
    return album.picture(caption, lambda: _draw_signal(data, signal))


def timing_picture(album: Album, data: StreamData) -> Markup:
    """Draw the time from each sample to the next."""
    caption = f"Time from each sample of /{data.device}/{data.stream.name} to the next; gaps are peaks."
    return album.picture(caption, lambda: _draw_timing(data))


LARGEST_DRAWN = 1e150
"""Larger values are left out of a picture: the length of an axis has to be squared."""


def _draw_signal(data: StreamData, signal: Signal) -> Figure:
    figure, axes = _strip(2.3 if signal.direction is Direction.OUTPUT else 1.9, legend=signal.width > 1)
    values = data.values[:, data.stream.columns_of(signal.name)]
    steps = "steps-post" if signal.hold is Hold.ZERO else "default"
    for column, name in enumerate(signal.columns()):
        t, drawn = envelope(data.t, values[:, column], data.seq)
        drawn = np.where(np.abs(drawn) > LARGEST_DRAWN, np.nan, drawn)
        if not np.isfinite(drawn).any():
            continue
        colour = COLOURS[column % len(COLOURS)]
        axes.plot(t, drawn, color=colour, lw=0.9, drawstyle=steps, label=_legend(signal, name))
    finish(axes, "", "time, s", label(signal.unit))
    if signal.width > 1:
        axes.legend(fontsize=7, ncols=6, loc="lower right", bbox_to_anchor=(1.0, 1.0), edgecolor="none")
    return figure


def _legend(signal: Signal, name: str) -> str | None:
    return label(name) if signal.width > 1 else None


def _draw_timing(data: StreamData) -> Figure:
    figure, axes = _strip(1.6)
    t, drawn = envelope(data.t[1:], 1e3 * np.diff(data.t))
    axes.plot(t, drawn, color=COLOURS[5], lw=0.8)
    if data.stream.rate > 0.0:
        axes.axhline(1e3 / data.stream.rate, color=COLOURS[1], lw=0.8, ls="--", label="nominal")
    axes.set_ylim(0.0, 1.25 * float(np.nanmax(drawn)))
    finish(axes, "", "time, s", "interval, ms")
    return figure


def _strip(height: float, *, legend: bool = False) -> tuple[Figure, Axes]:
    above = 0.3 if legend else 0.08
    height += above
    figure = figure_of((10.5, height))
    figure.set_layout_engine("none")
    bottom, top = 0.5 / height, 1.0 - above / height
    axes = figure.add_axes((LEFT, bottom, RIGHT - LEFT, top - bottom))
    axes.margins(x=0.01)
    return figure, axes


def envelope(t: FloatArray, values: FloatArray, seq: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Reduce a line to few points that show every extreme.

    Args:
        t: (n,), times.
        values: (n,), values; NaN counts as no extreme.
        seq: (n,), sequence numbers; a hole in them breaks the line.

    Returns:
        Times and values (m,), m at most about 1800, with NaN at breaks.
    """
    rows = np.arange(len(values)) if len(values) <= 2 * INTERVALS else _extremes(values)
    drawn = values[rows]
    if seq is None:
        return t[rows], drawn
    missing = np.concatenate(([0], np.cumsum(np.diff(seq) > 1)))[rows]
    breaks = np.flatnonzero(np.diff(missing) > 0) + 1
    return np.insert(t[rows], breaks, t[rows][breaks]), np.insert(drawn, breaks, np.nan)


def _extremes(values: FloatArray) -> IntArray:
    """Rows of the smallest and largest value of each interval, increasing."""
    n = len(values)
    width = -(-n // INTERVALS)
    n_intervals = -(-n // width)
    padded = np.concatenate((values, np.full(n_intervals * width - n, np.nan)))
    starts = np.arange(n_intervals) * width
    unknown = np.isnan(padded)
    smallest = starts + np.where(unknown, np.inf, padded).reshape(n_intervals, width).argmin(axis=1)
    largest = starts + np.where(unknown, -np.inf, padded).reshape(n_intervals, width).argmax(axis=1)
    return np.unique(np.concatenate((smallest, largest, [0, n - 1])))
