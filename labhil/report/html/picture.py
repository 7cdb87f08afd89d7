"""Figures as SVG inside a page, with the values along their axes for ``zoom.js``."""

from __future__ import annotations

import io
import json
import re
import warnings
from collections.abc import Callable
from itertools import count
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from labhil.report.html.element import Markup, clean, tag
from labhil.signals import FloatArray

SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: small, sharp, found by a search
    "svg.hashsalt": "labhil",  # the same figure makes the same file
    "text.parse_math": False,  # a dollar sign in a signal's name is no formula
    "axes.spines.top": False,
    "axes.spines.right": False,
}
MOST_DOTS = 500
"""A scatter of more dots is embedded as pixels: each dot would be an element."""

LONGEST_LABEL = 72
"""Characters at an axis; a longer text leaves no room for the picture beside it."""

PLACES = 65
"""Points along a nonlinear axis at which its values are given."""

LONG_DECIMAL = re.compile(r"(\.\d\d)\d+")

NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))


class Album:
    """Number the pictures of one page, so that no two of them share an identifier."""

    def __init__(self) -> None:
        self._numbers = count(1)

    def picture(self, caption: str, draw: Callable[[], Figure]) -> Markup:
        """Draw a figure as SVG with a caption.

        Args:
            caption: The caption, which is also the text for screen readers.
            draw: Draws the figure, with the settings of pages in force.
        """
        with mpl.rc_context(SETTINGS), warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*[Gg]lyph", category=UserWarning)
            svg = _svg(draw(), f"f{next(self._numbers)}-", caption)
        return tag("figure", svg, tag("figcaption", caption))


def _svg(figure: Figure, prefix: str, title: str) -> Markup:
    for axes in figure.axes:
        for dots in axes.collections:
            if isinstance(dots, PathCollection):
                dots.set_rasterized(np.asarray(dots.get_offsets()).shape[0] > MOST_DOTS)
    for number, axes in enumerate(figure.axes):
        axes.set_gid(f"plot_{number}")
    file = io.StringIO()
    figure.savefig(file, format="svg", dpi=150, metadata=NO_METADATA)
    svg = file.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    plots = [_place(figure, axes, f"{prefix}plot_{k}") for k, axes in enumerate(figure.axes) if axes.axison]
    attributes = tag("svg", role="img", aria_label=title, data_axes=json.dumps(plots)).text
    attributes = attributes.removeprefix("<svg").removesuffix("></svg>")
    return Markup(_prefix_ids(_slim(svg.replace("<svg", f"<svg{attributes}", 1)), prefix))


def _place(figure: Figure, axes: Axes, gid: str) -> dict[str, Any]:
    """Position of axes in the drawing, in points from the upper left, and the values along them."""
    width, height = 72.0 * figure.get_size_inches()
    box = axes.get_position()
    left, top = box.x0 * width, (1.0 - box.y1) * height
    wide, high = box.width * width, box.height * height
    shares = np.linspace(0.0, 1.0, PLACES)
    inverse = axes.transAxes + axes.transData.inverted()
    across = inverse.transform(np.column_stack([shares, np.zeros(PLACES)]))[:, 0]
    upward = inverse.transform(np.column_stack([np.zeros(PLACES), 1.0 - shares]))[:, 1]
    return {
        "id": gid,
        "left": round(left, 2),
        "top": round(top, 2),
        "width": round(wide, 2),
        "height": round(high, 2),
        "x": {"label": axes.get_xlabel(), **_table(left + shares * wide, across)},
        "y": {"label": axes.get_ylabel(), **_table(top + shares * high, upward)},
    }


def _table(places: FloatArray, values: FloatArray) -> dict[str, list[float]]:
    """Positions (points) and the values there; only the ends of a linear axis."""
    straight = np.interp(places, places[[0, -1]], values[[0, -1]])
    if np.allclose(values, straight, rtol=0.0, atol=1e-9 * np.ptp(values)):
        places, values = places[[0, -1]], values[[0, -1]]
    return {"at": np.round(places, 2).tolist(), "values": [float(f"{value:.9g}") for value in values]}


def _slim(svg: str) -> str:
    """The drawing without styles that the page has, with coordinates rounded to 0.01."""
    svg = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", svg, count=1, flags=re.DOTALL)
    svg = re.sub(r" font-family: [^;\"]*sans-serif;", "", svg)
    return re.sub(r' d="[^"]*"', lambda path: LONG_DECIMAL.sub(r"\1", path[0].replace("\n", "")), svg)


def _prefix_ids(svg: str, prefix: str) -> str:
    """The drawing with a prefix before all identifiers and references to them."""
    svg = re.sub(r'(\sid=")', rf"\g<1>{prefix}", svg)
    svg = re.sub(r'((?:xlink:)?href="#)', rf"\g<1>{prefix}", svg)
    return re.sub(r"(url\(#)", rf"\g<1>{prefix}", svg)


def label(text: str, unit: str = "") -> str:
    """Return the label of an axis: name and unit, cut where it is long."""
    full = clean(f"{text}, {unit}" if unit else text)
    return full if len(full) <= LONGEST_LABEL else f"{full[:LONGEST_LABEL]}…"
