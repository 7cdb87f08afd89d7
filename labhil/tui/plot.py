"""A chart of braille dots: lines told apart by how they are drawn, not by their colour alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.events import Resize
from textual.widgets import Static
from textual_plot import HiResMode, NumericAxisFormatter, PlotWidget

from labhil.signals import FloatArray
from labhil.tui.ring import envelope, pieces

Limits = tuple[float, float]


class Pen(StrEnum):
    """How a line is drawn; its picture stands in the legend."""

    SOLID = "━━"
    DASHED = "╍╍"
    DOTS = "··"


PENS = (Pen.SOLID, Pen.DASHED, Pen.DOTS)
DASH, PAUSE = 5, 4


@dataclass(frozen=True, slots=True)
class Curve:
    """A line of points (n,), or dots; NaN in ``y`` and steps longer than ``gap`` in ``x`` lift the pen.

    ``colour`` is a name from the theme, as ``curve-0``.
    """

    x: FloatArray
    y: FloatArray
    colour: str = "curve-0"
    pen: Pen = Pen.SOLID
    label: str = ""
    gap: float = math.inf


class Ticks(NumericAxisFormatter):
    """At most ``most`` ticks at round numbers, however small the axis is."""

    def __init__(self, most: int = 4) -> None:
        self.most = most

    def get_ticks(self, min_: float, max_: float, max_ticks: int = 8) -> list[float]:
        """Return where the ticks are; at least two, but where the axis has no length."""
        if not (math.isfinite(max_ - min_) and max_ > min_):
            return []
        step = round_step((max_ - min_) / max(1, self.most))
        ticks = _multiples(step, min_, max_)
        for _ in range(3):
            if len(ticks) < 2:  # a single tick says nothing of the scale
                step = round_step(step / 2.6)
                ticks = _multiples(step, min_, max_)
        return ticks

    def get_labels_for_ticks(self, ticks: Sequence[float]) -> list[str]:
        """Return what stands at them."""
        if not ticks:
            return []
        step = ticks[1] - ticks[0] if len(ticks) > 1 else abs(ticks[0]) or 1.0
        largest = max(abs(tick) for tick in ticks)
        if largest >= 1e5 or (0 < largest < 1e-3):
            return [f"{tick:.1e}".replace("e-0", "e-").replace("e+0", "e") for tick in ticks]
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        return [f"{tick + 0.0:.{decimals}f}".replace("-", "−") for tick in ticks]


def _multiples(step: float, low: float, high: float) -> list[float]:
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def round_step(step: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not smaller than ``step``."""
    if not step > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(step))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= step * (1 - 1e-9))


def limits_of(values: Sequence[FloatArray]) -> Limits:
    """Round limits around all finite values, with a little room; (−1, 1) where there are none."""
    finite = [v[np.isfinite(v)] for v in values]
    finite = [v for v in finite if len(v)]
    if not finite:
        return -1.0, 1.0
    low, high = min(float(v.min()) for v in finite), max(float(v.max()) for v in finite)
    middle, half = (low + high) / 2, (high - low) / 2
    half = max(half * 1.05, abs(middle) * 1e-6, 1e-12)
    step = round_step(half / 2.5)
    return math.floor((middle - half) / step) * step, math.ceil((middle + half) / step) * step


class Canvas(PlotWidget):
    """The plot itself: textual-plot with narrower margins and our ticks."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("r", "reset_scales", "Whole", id="plot.whole", tooltip="Undo zooming and panning"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self.x_ticks, self.y_ticks = Ticks(6), Ticks(3)
        self.set_x_formatter(self.x_ticks)
        self.set_y_formatter(self.y_ticks)

    def compose(self) -> ComposeResult:
        """Set the margins before the first layout."""
        self.set_reactive(PlotWidget.margin_top, 0)
        self.set_reactive(PlotWidget.margin_bottom, 1)
        self.set_reactive(PlotWidget.margin_left, 9)
        yield from super().compose()


class Chart(Vertical):
    """A title with the legend, and the plot under it; redrawn from its curves when it changes its size."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:  # noqa: A002
        super().__init__(id=id, classes=classes)
        self._heading = Static("", classes="chart-title")
        self._canvas = Canvas()
        self._curves: tuple[Curve, ...] = ()
        self._x: Limits | None = None
        self._y: Limits | None = None
        self._title = Text()

    def compose(self) -> ComposeResult:
        """The two parts."""
        yield self._heading
        yield self._canvas

    def on_mount(self) -> None:
        """Draw what was given before there was anything to draw on; follow changes of the theme."""
        self.app.theme_changed_signal.subscribe(self, lambda _theme: self._draw())
        self.call_after_refresh(self._draw)

    def on_resize(self, _event: Resize) -> None:
        """As many points as there are columns, and as many ticks as there is room for."""
        self.call_after_refresh(self._draw)

    @property
    def columns(self) -> int:
        """Columns of the plot itself."""
        return max(8, self._canvas.size.width - self._canvas.margin_left - 2)

    def show(
        self, title: str | Text, curves: Sequence[Curve], x: Limits | None = None, y: Limits | None = None
    ) -> None:
        """Draw ``curves``; limits that are None are those of the points."""
        self._title = Text(title, no_wrap=True, overflow="ellipsis") if isinstance(title, str) else title
        self._curves, self._x, self._y = tuple(curves), x, y
        if self.is_mounted:
            self._draw()

    def colour(self, name: str) -> str:
        """A colour of the theme in force."""
        return self.app.theme_variables.get(name, "#888888")

    def _draw(self) -> None:
        if not self.is_mounted or not self._canvas.is_mounted or not self._canvas.size.height:
            return
        self._heading.update(self._legend())
        plot = self._canvas
        height = max(1, plot.size.height - 3)
        plot.y_ticks.most = max(1, min(6, height // 2))
        plot.x_ticks.most = max(2, min(10, self.columns // 9))
        plot.clear()
        finite_x = [curve.x for curve in self._curves]
        plot.set_xlimits(*(self._x or _span(finite_x)))
        plot.set_ylimits(*(self._y or limits_of([curve.y for curve in self._curves])))
        for curve in self._curves:
            self._draw_curve(curve)

    def _legend(self) -> Text:
        line = self._title.copy()
        for curve in self._curves:
            if curve.label:
                line.append("   ")
                line.append(f"{curve.pen.value} {curve.label}", style=self.colour(curve.colour))
        return line

    def _draw_curve(self, curve: Curve) -> None:
        colour, plot = self.colour(curve.colour), self._canvas
        if curve.pen is Pen.DOTS:
            x, y = envelope(curve.x, curve.y, self.columns)
            plot.scatter(x, y, marker_style=colour, hires_mode=HiResMode.BRAILLE)
            return
        for x, y in _runs(curve, self.columns):
            for part in _dashes(len(x)) if curve.pen is Pen.DASHED else (slice(0, len(x)),):
                plot.plot(x[part], y[part], line_style=colour, hires_mode=HiResMode.BRAILLE)


def _span(arrays: Sequence[FloatArray]) -> Limits:
    filled = [array for array in arrays if len(array)]
    if not filled:
        return 0.0, 1.0
    low, high = min(float(a.min()) for a in filled), max(float(a.max()) for a in filled)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _runs(curve: Curve, columns: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The stretches between two lifts of the pen, reduced to what the columns can show."""
    good = np.isfinite(curve.y)
    breaks = np.flatnonzero(np.diff(good.astype(np.int8))) + 1
    total = max(1, len(curve.x))
    for part in np.split(np.arange(total), breaks) if len(curve.x) else ():
        if not good[part[0]]:
            continue
        x, y = curve.x[part], curve.y[part]
        for run in pieces(x, curve.gap):
            share = max(2, math.ceil(columns * (run.stop - run.start) / total))
            yield envelope(x[run], y[run], share)


def _dashes(count: int) -> Iterator[slice]:
    start = 0
    while start < count:
        yield slice(start, min(count, start + DASH))
        start += DASH + PAUSE - 1
