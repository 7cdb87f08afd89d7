"""The picture of a nonparametric curve with its band."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from labhil.analysis.schema import EstimatedCurve
from labhil.report.figure import AFTER, figure_of, finish
from labhil.report.html.element import Markup
from labhil.report.html.picture import Album, label
from labhil.signals import FloatArray


def curve_picture(album: Album, curve: EstimatedCurve | None) -> Markup | None:
    """Draw the curve over its coordinate, or as coloured dots over two coordinates.

    Args:
        album: The pictures of the page.
        curve: The curve; None for none.

    Returns:
        The picture; None where there is nothing to draw.
    """
    if curve is None:
        return None
    x, value = _coordinates(curve), np.array(curve.value, dtype=np.float64)
    if not len(value) or not len(x) or x.shape[1] != len(value):
        return None
    if len(x) == 1:
        where = "" if curve.joint is None else f" on joint {curve.joint}"
        caption = f"Estimated curve of what no named term explains{where}, with its 99 % band."
        return album.picture(caption, lambda: _draw_curve(curve, x[0], value))
    caption = "Estimate of what no named term explains, over the first two coordinates that it depends on."
    return album.picture(caption, lambda: _draw_dots(curve, x, value))


def _coordinates(curve: EstimatedCurve) -> FloatArray:
    """Coordinates with one row each (k, n), from either orientation in the file; empty if ragged."""
    if len({len(row) for row in curve.x}) != 1:
        return np.empty((0, 0))
    x = np.array(curve.x, dtype=np.float64)
    return x if len(x) == len(curve.depends_on) else x.T


def _draw_curve(curve: EstimatedCurve, x: FloatArray, value: FloatArray) -> Figure:
    figure = figure_of((10.0, 4.0))
    axes = figure.subplots()
    order = np.argsort(x)
    if len(curve.ci99) == 2 and all(len(side) == len(value) for side in curve.ci99):
        low, high = (np.array(side, dtype=np.float64)[order] for side in curve.ci99)
        axes.fill_between(x[order], low, high, color=AFTER, alpha=0.25, lw=0, label="99 % band")
    axes.plot(x[order], value[order], color=AFTER, lw=1.8, label="estimate")
    axes.axhline(0.0, color="k", lw=0.6)
    finish(axes, "", label(curve.depends_on[0]), label("estimate", curve.unit))
    return figure


def _draw_dots(curve: EstimatedCurve, x: FloatArray, value: FloatArray) -> Figure:
    figure = figure_of((10.0, 5.0))
    axes = figure.subplots()
    dots = axes.scatter(x[0], x[1], c=value, s=14, cmap="coolwarm")
    figure.colorbar(dots, ax=axes, label=label("estimate", curve.unit))
    finish(axes, "", label(curve.depends_on[0]), label(curve.depends_on[1]))
    return figure
