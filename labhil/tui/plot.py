"""Charts: a title with the legend, and under it curves of braille dots with axes, to zoom and to move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.events import Click, MouseEvent, MouseMove, MouseScrollDown, MouseScrollUp, Resize
from textual.geometry import Region
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Static

from labhil.signals import FloatArray
from labhil.tui.curve import Curve, drawn
from labhil.tui.ticks import Limits, labels, limits_of, ticks

MARGIN = 9
"""Columns on the left for what stands at the ticks."""
FRAME = 2
"""Columns, and rows, of the frame around the curves; one more row under it is for the ticks of x."""

ZOOM, WHEEL_ZOOM, MOVE = 0.15, 0.05, 0.1
"""By how much a key or the wheel narrows the view at each side, and how far a key moves it: shares of it."""

View = tuple[Limits, Limits]


class Plot(Widget, can_focus=True):
    """The curves and their axes. A picture is made once for what is shown, not once for each line of it."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {"plot--axis", "plot--tick"}
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("plus", "zoom(1)", "Zoom in", id="plot.in", key_display="+"),
        Binding("minus", "zoom(-1)", "Zoom out", id="plot.out", key_display="-"),
        Binding("left", "move(-1, 0)", "Left", id="plot.left", show=False),
        Binding("right", "move(1, 0)", "Right", id="plot.right", show=False),
        Binding("up", "move(0, 1)", "Up", id="plot.up", show=False),
        Binding("down", "move(0, -1)", "Down", id="plot.down", show=False),
        Binding("shift+left", "cursor(-1)", "Cursor left", id="plot.cursor.left", show=False),
        Binding(
            "shift+right",
            "cursor(1)",
            "Cursor",
            id="plot.cursor.right",
            key_display="shift →",
            tooltip="Read the values there; shift+left moves it back",
        ),
        Binding("r", "whole", "Whole", id="plot.whole", tooltip="Undo zooming and moving"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._curves: tuple[Curve, ...] = ()
        self._whole: View = ((0.0, 1.0), (-1.0, 1.0))
        self._seen = self._whole
        self._lines: list[Strip] = []
        self.cursor: float | None = None
        """Where on x the values are read, None for nowhere."""

    @dataclass
    class CursorMoved(Message):
        """The values are read elsewhere."""

        x: float | None

    @property
    def view(self) -> View:
        """The limits of x and of y that are shown."""
        return self._seen

    def show(self, curves: Sequence[Curve], x: Limits, y: Limits, *, keep_view: bool = False) -> None:
        """Draw these between these limits, or with ``keep_view`` between those that were zoomed to."""
        is_zoomed = self._seen != self._whole
        self._curves, self._whole = tuple(curves), (_spread(x), _spread(y))
        self._look_at(self._seen if keep_view and is_zoomed else self._whole)

    def notify_style_update(self) -> None:
        """Draw anew, in the colours of another theme."""
        super().notify_style_update()
        self._look_at(self._seen)

    def on_resize(self, _event: Resize) -> None:
        """Draw anew, as large as it is now."""
        self._look_at(self._seen)

    def _look_at(self, view: View) -> None:
        self._seen, self._lines = view, []
        self.refresh()

    def render_lines(self, crop: Region) -> list[Strip]:
        """The part of the picture that is asked for; there is no border and no padding around it."""
        width, height = self.size
        if not self._lines:
            self._lines = self._picture(width - MARGIN - FRAME, height - FRAME - 1)
        lines = self._lines[crop.y : crop.bottom]
        return lines if crop.width == width else [line.crop(crop.x, crop.right) for line in lines]

    def _picture(self, columns: int, rows: int) -> list[Strip]:
        """Every line, as wide as the widget, with the terminal's filters (as without colours) applied."""
        base, (width, height) = self.rich_style, self.size
        drawn = self._frame(columns, rows, base) if columns > 0 and rows > 0 else [Strip.blank(0)] * height
        lines = [line.adjust_cell_length(width, base) for line in drawn]
        behind = self.background_colors[1]
        for line_filter in self.app.get_line_filters():
            lines = [line.apply_filter(line_filter, behind) for line in lines]
        return lines

    def _frame(self, columns: int, rows: int, base: Style) -> list[Strip]:
        known = self.app.theme_variables
        axis = base + self.get_component_rich_style("plot--axis", partial=True)
        tick = base + self.get_component_rich_style("plot--tick", partial=True)
        pens = [base + Style(color=known.get(curve.colour, "#888888")) for curve in self._curves]
        raster = drawn(self._curves, *self._seen, columns, rows)
        across, beside = self._ticks_of_x(columns), self._ticks_of_y(rows)
        margin, cursor = Segment(" " * (MARGIN - 1), tick), self._cursor_column(columns)
        lines = [Strip([margin, Segment(" " + _edge("┏", "━", "┻", "┓", columns, across), axis)])]
        for row in range(rows):
            label, left, right = (beside[row], "┫", "┣") if row in beside else ("", "┃", "┃")
            cells = [Segment(text, pens[owner] if owner >= 0 else base) for text, owner in raster.runs(row)]
            head = [Segment(label.rjust(MARGIN - 1)[: MARGIN - 1], tick), Segment(f" {left}", axis)]
            if cursor is not None:
                whole = Strip(cells)
                mark = Strip([Segment("│", tick)])
                cells = list(Strip.join([whole.crop(0, cursor), mark, whole.crop(cursor + 1)]))
            lines.append(Strip([*head, *cells, Segment(right, axis)]))
        lines.append(Strip([margin, Segment(" " + _edge("┗", "━", "┳", "┛", columns, across), axis)]))
        lines.append(Strip([Segment(_under(across, MARGIN + FRAME + columns), tick)]))
        return lines

    def _ticks_of_x(self, columns: int) -> dict[int, str]:
        """What stands under which column."""
        low, high = self._seen[0]
        found = ticks(low, high, max(2, min(10, columns // 9)))
        places = [round((tick - low) / (high - low) * (columns - 1)) for tick in found]
        return dict(zip(places, labels(found), strict=True))

    def _ticks_of_y(self, rows: int) -> dict[int, str]:
        """What stands beside which row."""
        low, high = self._seen[1]
        found = ticks(low, high, max(1, min(6, rows // 3)))
        places = [round((high - tick) / (high - low) * (rows - 1)) for tick in found]
        return dict(zip(places, labels(found), strict=True))

    def _cursor_column(self, columns: int) -> int | None:
        """The column of the cursor, where it is in view."""
        (low, high), x = self._seen[0], self.cursor
        return None if x is None or not low <= x <= high else round((x - low) / (high - low) * (columns - 1))

    # looking around

    def action_whole(self) -> None:
        """Show all of it again, without a cursor."""
        self._put_cursor(None)
        self._look_at(self._whole)

    def action_cursor(self, way: int) -> None:
        """Move the cursor by a column; the first time it comes in the middle."""
        columns, (low, high) = self.size.width - MARGIN - FRAME, self._seen[0]
        column = self._cursor_column(columns)
        if columns > 1:
            place = columns // 2 if column is None else min(max(column + way, 0), columns - 1)
            self._put_cursor(low + (high - low) * place / (columns - 1))

    def on_click(self, event: Click) -> None:
        """Put the cursor where it was clicked."""
        columns, (low, high) = self.size.width - MARGIN - FRAME, self._seen[0]
        place = event.x - MARGIN - 1
        if columns > 1 and 0 <= place < columns:
            self._put_cursor(low + (high - low) * place / (columns - 1))

    def _put_cursor(self, x: float | None) -> None:
        if x != self.cursor:
            self.cursor = x
            self.post_message(self.CursorMoved(x))
            self._look_at(self._seen)

    def action_zoom(self, way: int) -> None:
        """Show less, or more, around the middle."""
        self._zoom(ZOOM * way, 0.5, 0.5)

    def action_move(self, right: int, up: int) -> None:
        """Show what lies beside."""
        self._move(MOVE * right, MOVE * up)

    def _zoom(self, share: float, right: float, up: float) -> None:
        """Narrow the view about a place in it (shares of it from the left and from below)."""
        about = (right, up)
        seen = [
            (low + 2 * at * share * (high - low), high - 2 * (1 - at) * share * (high - low))
            for (low, high), at in zip(self._seen, about, strict=True)
        ]
        if all(low + abs(low) * 1e-9 < high for low, high in seen):  # no further than numbers reach
            self._look_at((seen[0], seen[1]))

    def _move(self, right: float, up: float) -> None:
        (x0, x1), (y0, y1) = self._seen
        dx, dy = right * (x1 - x0), up * (y1 - y0)
        self._look_at(((x0 + dx, x1 + dx), (y0 + dy, y1 + dy)))

    def on_mouse_scroll_up(self, event: MouseScrollUp) -> None:
        """Zoom in at the pointer, once the chart has been clicked; before that the page scrolls."""
        self._wheel(event, WHEEL_ZOOM)

    def on_mouse_scroll_down(self, event: MouseScrollDown) -> None:
        """Zoom out at the pointer."""
        self._wheel(event, -WHEEL_ZOOM)

    def _wheel(self, event: MouseEvent, share: float) -> None:
        columns, rows = self.size.width - MARGIN - FRAME, self.size.height - FRAME - 1
        if not self.has_focus or columns < 1 or rows < 1:
            return
        event.stop()
        right, down = (event.x - MARGIN - 1) / columns, (event.y - 1) / rows
        self._zoom(share, min(max(right, 0.0), 1.0), min(max(1 - down, 0.0), 1.0))

    def on_mouse_move(self, event: MouseMove) -> None:
        """Drag the picture."""
        columns, rows = self.size.width - MARGIN - FRAME, self.size.height - FRAME - 1
        if event.button == 1 and columns > 0 and rows > 0:
            self._move(-event.delta_x / columns, event.delta_y / rows)


class Chart(Vertical):
    """A title with the legend, and the plot under it."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:  # noqa: A002
        super().__init__(id=id, classes=classes)
        self._heading = Static("", classes="chart-title")
        self._plot = Plot()
        self._curves: tuple[Curve, ...] = ()
        self._title = Text()

    def compose(self) -> ComposeResult:
        """The two parts."""
        yield self._heading
        yield self._plot

    def on_mount(self) -> None:
        """Write what was given before there was anything to write on; follow changes of the theme."""
        self.app.theme_changed_signal.subscribe(self, lambda _theme: self._write())
        self._write()

    def show(
        self,
        title: str | Text,
        curves: Sequence[Curve],
        x: Limits | None = None,
        y: Limits | None = None,
        *,
        keep_view: bool = False,
    ) -> None:
        """Draw ``curves``; limits that are None are those of the points.

        With ``keep_view`` what has been zoomed into stays in view.
        """
        self._title = Text(title, no_wrap=True, overflow="ellipsis") if isinstance(title, str) else title
        self._curves = tuple(curves)
        span = x or _span([curve.x for curve in curves])
        self._plot.show(curves, span, y or limits_of([curve.y for curve in curves]), keep_view=keep_view)
        if self.is_mounted:
            self._write()

    def on_plot_cursor_moved(self, message: Plot.CursorMoved) -> None:
        """Write the values there."""
        message.stop()
        self._write()

    def _write(self) -> None:
        known, line = self.app.theme_variables, self._title.copy()
        x = self._plot.cursor
        if x is not None:
            line.append(f" at {x:.4g}:", style="bold")
            for curve in self._curves:
                value = _value_at(curve, x)
                line.append(f"  {curve.pen.value} ", style=known.get(curve.colour, "#888888"))
                line.append("–" if value is None else f"{value:.4g}".replace("-", "−"), style="bold")
            self._heading.update(line, layout=False)
            return
        for curve in self._curves:
            if curve.label:
                line.append("   ")
                line.append(f"{curve.pen.value} {curve.label}", style=known.get(curve.colour, "#888888"))
        self._heading.update(line, layout=False)  # it is one line, whatever it says


def _value_at(curve: Curve, x: float) -> float | None:
    """The value of the point nearest to ``x``; None where there is none, or the pen is lifted."""
    if not len(curve.x):
        return None
    value = float(curve.y[int(np.argmin(np.abs(curve.x - x)))])
    return value if np.isfinite(value) else None


def _span(arrays: Sequence[FloatArray]) -> Limits:
    filled = [array for array in arrays if len(array)]
    if not filled:
        return 0.0, 1.0
    return min(float(a.min()) for a in filled), max(float(a.max()) for a in filled)


def _spread(limits: Limits) -> Limits:
    """Limits that are apart."""
    low, high = limits
    return limits if high > low else (low - 0.5, high + 0.5)


def _edge(left: str, line: str, tick: str, right: str, columns: int, across: dict[int, str]) -> str:
    return left + "".join(tick if column in across else line for column in range(columns)) + right


def _under(across: dict[int, str], width: int) -> str:
    """The labels of the ticks of x, each centred under its tick; one that has no room is left out."""
    line, free = "", 0
    for column, label in across.items():
        start = min(MARGIN + 1 + column - len(label) // 2, width - len(label))
        if start >= free:
            line = line.ljust(start) + label
            free = len(line) + 1
    return line
