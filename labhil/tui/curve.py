"""A plotted curve, and how it is drawn on a raster; curves differ in their pen, not in colour alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from labhil.signals import FloatArray
from labhil.tui.raster import ACROSS, DOWN, Raster
from labhil.tui.ring_buffer import envelope, split_at_gaps
from labhil.tui.themes import CURVES
from labhil.tui.ticks import Limits


class Pen(StrEnum):
    """How a line is drawn; the value is its sample in the legend."""

    SOLID = "━━"
    DASHED = "╍╍"
    DOTS = "··"


PENS = (Pen.SOLID, Pen.DASHED, Pen.DOTS)
DASH, PAUSE = 4, 4
"""Lengths of dashes and of the gaps between them, in points of the curve."""


@dataclass(frozen=True, slots=True)
class PlotCurve:
    """Hold a line of points, or dots.

    Attributes:
        x: (n,)
        y: (n,); NaN breaks the line.
        colour: Name of a colour of the theme, such as ``curve-0``.
        pen: Solid, dashed, or dots.
        label: Text in the legend; empty for none.
        gap: Longest step in ``x`` that the line bridges.
    """

    x: FloatArray
    y: FloatArray
    colour: str = "curve-0"
    pen: Pen = Pen.SOLID
    label: str = ""
    gap: float = math.inf


def longest_gap(t: FloatArray, *, periods: float = 5.0) -> float:
    """Return the longest step between samples at ``t`` (n ≥ 2) that a line bridges, in the unit of ``t``."""
    return periods * float(np.median(np.diff(t)))


def column_curves(
    x: FloatArray, values: FloatArray, columns: int, number: int, gap: float
) -> list[PlotCurve]:
    """Make a curve for each column of a signal, with colours and pens that differ.

    Args:
        x: (n,)
        values: (n, columns or more)
        columns: Number of columns; each has its number in the legend, a single one nothing.
        number: Number of the signal, which decides the first colour.
        gap: Longest step in ``x`` that the lines bridge.
    """
    return [
        PlotCurve(
            x,
            values[:, i],
            f"curve-{(number + i) % CURVES}",
            PENS[i // 2 % len(PENS)],
            str(i) if columns > 1 else "",
            gap,
        )
        for i in range(columns)
    ]


def draw_curves(curves: Sequence[PlotCurve], x: Limits, y: Limits, columns: int, rows: int) -> Raster:
    """Draw curves between limits.

    Args:
        curves: The curves; later ones cover earlier ones.
        x: Limits of x.
        y: Limits of y.
        columns: Width of the raster in cells.
        rows: Height of the raster in cells.

    Returns:
        The raster, whose dots are owned by the index of their curve.
    """
    raster = Raster(columns, rows)
    for number, curve in enumerate(curves):
        visible = _clip(curve, x)
        runs = [envelope(visible.x, visible.y, columns)] if curve.pen is Pen.DOTS else _runs(visible, columns)
        for part_x, part_y in runs:
            across = (part_x - x[0]) * ((ACROSS * columns - 1) / (x[1] - x[0]))
            down = (y[1] - part_y) * ((DOWN * rows - 1) / (y[1] - y[0]))
            if curve.pen is Pen.DOTS:
                raster.dots(across, down, number)
            elif curve.pen is Pen.DASHED:
                raster.line(across, down, number, np.arange(len(part_x) - 1) % (DASH + PAUSE) < DASH)
            else:
                raster.line(across, down, number)
    return raster


def _clip(curve: PlotCurve, limits: Limits) -> PlotCurve:
    """The points between the limits, and one beyond each, so that lines reach the edge."""
    inside = (curve.x >= limits[0]) & (curve.x <= limits[1])
    if inside.all():
        return curve
    near = inside.copy()
    near[1:] |= inside[:-1]
    near[:-1] |= inside[1:]
    return PlotCurve(curve.x[near], curve.y[near], curve.colour, curve.pen, curve.label, curve.gap)


def _runs(curve: PlotCurve, columns: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The unbroken parts of a curve, reduced to what the columns can show."""
    finite = np.isfinite(curve.y)
    breaks = np.flatnonzero(np.diff(finite.astype(np.int8))) + 1
    total = max(1, len(curve.x))
    for part in np.split(np.arange(total), breaks) if len(curve.x) else ():
        if not finite[part[0]]:
            continue
        x, y = curve.x[part], curve.y[part]
        for run in split_at_gaps(x, curve.gap):
            width = max(2, math.ceil(columns * (run.stop - run.start) / total))
            yield envelope(x[run], y[run], width)
