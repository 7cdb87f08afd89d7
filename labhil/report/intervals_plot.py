"""The intervals of a fit as a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.analysis.schema import Parameter
from labhil.report.figure import AFTER, figure_of, finish
from labhil.report.html.picture import label
from labhil.report.html.quantity import quantity

WIDEST = 120.0
"""Intervals beyond that many per cent of their value are drawn with an arrow."""

UNSURE = "#8a8f96"

MOST_ROWS = 200
"""Parameters that a picture shows, of which the table beside it has all."""


def drawable(rows: Sequence[Parameter]) -> list[Parameter]:
    """Those with a value and an interval, ``MOST_ROWS`` at most."""
    return [row for row in rows if row.value and row.ci99 and None not in row.ci99][:MOST_ROWS]


def intervals_figure(rows: Sequence[Parameter]) -> Figure:
    """Every parameter with its interval, as a figure."""
    figure = figure_of((10.0, 0.9 + 0.3 * len(drawable(rows))))
    draw_intervals(figure.subplots(), rows)
    return figure


def draw_intervals(axes: Axes, parameters: Sequence[Parameter]) -> None:
    """Every parameter with its interval, in per cent of its value."""
    rows = drawable(parameters)
    if not rows:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no parameter has an interval", ha="center")
        return
    spans = np.array([_relative(row) for row in rows])
    limit = min(WIDEST, 1.15 * float(np.abs(spans).max()) or 1.0)
    for place, (row, (low, high)) in enumerate(zip(rows, spans.tolist(), strict=True)):
        _draw_interval(axes, place, (low, high), limit, UNSURE if _unsure(row) else AFTER)
    axes.axvline(0.0, color="k", lw=0.6)
    axes.set_xlim(-1.08 * limit, 1.08 * limit)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_yticks(range(len(rows)), [label(_labelled(row)) for row in rows])
    finish(axes, "", "99 % interval − estimate, % of the estimate", "")
    axes.grid(visible=False, axis="y")


def _draw_interval(axes: Axes, place: int, span: tuple[float, float], limit: float, colour: str) -> None:
    low, high = max(span[0], -limit), min(span[1], limit)
    axes.plot([low, high], [place, place], color=colour, lw=3.0, solid_capstyle="butt")
    axes.plot([0.0], [place], "o", color=colour, ms=5.5)
    if span[0] < -limit:
        axes.plot([low], [place], "<", color=colour, ms=7)
    if span[1] > limit:
        axes.plot([high], [place], ">", color=colour, ms=7)


def _relative(row: Parameter) -> tuple[float, float]:
    """Ends of the interval less the value, in per cent of the value."""
    value = row.value or 1.0
    low, high = row.ci99 or (None, None)
    ends = [100.0 * ((value if end is None else end) - value) / abs(value) for end in (low, high)]
    return ends[0], ends[1]


def _unsure(row: Parameter) -> bool:
    return not row.identifiable or row.significant is False


def _labelled(row: Parameter) -> str:
    return f"{row.key} = {quantity(row.value, row.unit)}"
