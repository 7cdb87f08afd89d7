"""The confidence intervals of all parameters of a fit in one figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.analysis.schema import Parameter
from labhil.report.figure import AFTER, figure_of, finish
from labhil.report.formatting import format_quantity
from labhil.report.html.picture import label

UNCERTAIN = "#8a8f96"


def drawable(rows: Sequence[Parameter], *, max_rows: int = 200) -> list[Parameter]:
    """Return the rows that have a value and an interval, at most 200; the table has all."""
    return [row for row in rows if row.value and row.ci99 and None not in row.ci99][:max_rows]


def intervals_figure(rows: Sequence[Parameter]) -> Figure:
    """Draw each parameter with its interval as a figure."""
    figure = figure_of((10.0, 0.9 + 0.3 * len(drawable(rows))))
    draw_intervals(figure.subplots(), rows)
    return figure


def draw_intervals(axes: Axes, parameters: Sequence[Parameter], *, max_percent: float = 120.0) -> None:
    """Draw each parameter with its interval, in per cent of its value.

    Args:
        axes: Where to draw.
        parameters: The parameters; those without an interval are left out.
        max_percent: Per cent of the value beyond which an interval ends in an arrow.
    """
    rows = drawable(parameters)
    if not rows:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no parameter has an interval", ha="center")
        return
    spans = np.array([_relative_interval(row) for row in rows])
    limit = min(max_percent, 1.15 * float(np.abs(spans).max()) or 1.0)
    for place, (row, (low, high)) in enumerate(zip(rows, spans.tolist(), strict=True)):
        _draw_interval(axes, place, (low, high), limit, UNCERTAIN if _is_uncertain(row) else AFTER)
    axes.axvline(0.0, color="k", lw=0.6)
    axes.set_xlim(-1.08 * limit, 1.08 * limit)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_yticks(range(len(rows)), [label(_tick_text(row)) for row in rows])
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


def _relative_interval(row: Parameter) -> tuple[float, float]:
    """Ends of the interval less the value, in per cent of the value."""
    value = row.value or 1.0
    low, high = row.ci99 or (None, None)
    percentages = [
        100.0 * ((value if limit is None else limit) - value) / abs(value) for limit in (low, high)
    ]
    return percentages[0], percentages[1]


def _is_uncertain(row: Parameter) -> bool:
    return not row.identifiable or row.significant is False


def _tick_text(row: Parameter) -> str:
    return f"{row.key} = {format_quantity(row.value, row.unit)}"
