"""Several models over one measurement, each of which the reader can switch on and off.

It works without a script: a legend entry is a checkbox, and ``style.css`` hides what belongs to an unchecked
one. Lines have the number of their model in their identifier, ``…-model-2-…``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.analysis.comparison import ComparisonResult
from labhil.identify.score import Score
from labhil.physics.record import Record
from labhil.physics.terms import keyed
from labhil.report.figure import MEASURED, figure_of, finish
from labhil.report.formatting import format_quantity
from labhil.report.html.element import Markup, tag
from labhil.report.html.picture import Album, label
from labhil.report.html.signals import envelope
from labhil.signals import FloatArray, IntArray

COLOURS = ("#c8553d", "#1f5f8b", "#2a7f62", "#b07aa1", "#8a5a00", "#17a2b8", "#7c3a85", "#57606a")
"""Colours of the models in their order; style.css has the same for the legend."""

DASHES = ("-", "-", "-", "-", "--", "--", "--", "--")
MOST_PICTURES = 12

FAR_OFF = 15.0
"""Noise floors from which on an error needs a logarithmic scale to be seen beside the noise."""

LINEAR = 3.0
"""Noise floors up to which the logarithmic scale is linear."""

WINDOW_STEP = 2
"""Jump in the sample numbers between two windows, which leaves a gap in the line."""


@dataclass(frozen=True, slots=True)
class Overlaid:
    """A recording with the score of each model on the same windows of it; ``path`` is its file."""

    path: str
    record: Record
    scores: tuple[Score, ...]


def overlays(comparison: ComparisonResult, album: Album) -> tuple[Markup, ...]:
    """Make a legend with switches, and a picture of each output of each recording."""
    recordings = [Overlaid(each.source.path, each.record, each.scores) for each in comparison.recordings]
    return (overlay(comparison.names, recordings, album),)


def overlay(names: Sequence[str], recordings: Sequence[Overlaid], album: Album) -> Markup:
    """Make the same of models by name, at most as many as there are ``COLOURS``."""
    outputs = [(recording, j) for recording in recordings for j in range(recording.record.outputs.shape[1])]
    several = len(recordings) > 1
    pictures = [_picture(album, recording, j, several=several) for recording, j in outputs[:MOST_PICTURES]]
    n_omitted = len(outputs) - len(pictures)
    more = (
        tag("p", f"{n_omitted} further outputs are in the table only.", class_="remark")
        if n_omitted
        else None
    )
    return tag("div", *switches(names), *pictures, more, class_="overlay")


def switches(names: Sequence[str]) -> list[Markup]:
    """Make a checkbox for each model, with its label; they come before the pictures that they switch."""
    elements = []
    for number, name in enumerate(("measured", *names)):
        elements += [
            tag("input", type="checkbox", id=f"show-{number}", class_=f"show-{number}", checked="checked"),
            tag("label", tag("span", class_=f"swatch swatch-{number}"), name, for_=f"show-{number}"),
        ]
    return elements


def _picture(album: Album, recording: Overlaid, j: int, *, several: bool) -> Markup:
    channel = recording.scores[0].channels[j]
    name = keyed(channel.channel, channel.joint)
    where = f" of {recording.path}" if several else ""
    caption = (
        f"{name}{where}: measurement and simulations above, each model's error (simulated − measured) below, "
        "with the noise floor as a grey band."
    )
    return album.picture(caption, lambda: _draw(recording, j))


def _draw(recording: Overlaid, j: int) -> Figure:
    figure = figure_of((10.5, 5.6))
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    first = recording.scores[0]
    channel = first.channels[j]
    t, measured = recording.record.t[first.rows], recording.record.outputs[first.rows, j]
    window = first.window
    _line(above, t, measured, window, "model-0-measured", color=MEASURED, lw=2.6, alpha=0.45)
    for number, score in enumerate(recording.scores, 1):
        style: dict[str, Any] = {"color": COLOURS[number - 1], "ls": DASHES[number - 1]}
        errors = score.errors[:, j]
        _line(above, t, measured + errors, window, f"model-{number}-simulated", lw=1.1, **style)
        _line(below, t, errors, window, f"model-{number}-error", lw=0.9, **style)
    floor = min(score.channels[j].noise_floor for score in recording.scores)
    below.axhspan(-floor, floor, color="k", alpha=0.14, lw=0)
    worst = max(score.channels[j].rmse for score in recording.scores)
    name = label("error", channel.unit)
    if worst > FAR_OFF * floor:
        below.set_yscale("symlog", linthresh=LINEAR * floor, linscale=1.2)
        below.yaxis.set_major_formatter(lambda value, _place: format_quantity(value, digits=1))
        name = label("error (log. scale)", channel.unit)
    _limit(above, measured, 0.35)
    finish(above, "", "", label(keyed(channel.channel, channel.joint), channel.unit))
    finish(below, "", "time, s", name)
    figure.align_ylabels()
    return figure


def _line(
    axes: Axes, t: FloatArray, values: FloatArray, window: IntArray, identifier: str, **style: Any
) -> None:
    """Draw a line of few points, with a gap where a new window begins."""
    finite = np.where(np.isfinite(values), values, np.nan)
    x, y = envelope(t, finite, WINDOW_STEP * window + np.arange(len(t)))
    axes.plot(x, y, gid=identifier, **style)


def _limit(axes: Axes, measured: FloatArray, room: float) -> None:
    """Limit the y axis to the measurement, so that a diverging simulation does not flatten it."""
    low, high = float(measured.min()), float(measured.max())
    margin = room * max(high - low, 1e-12)
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - margin), min(top, high + margin))
