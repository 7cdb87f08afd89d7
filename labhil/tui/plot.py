"""Charts: a title with the legend, and curves of braille dots with axes, to zoom and to move."""

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

from labhil.report.formatting import NOTHING
from labhil.signals import FloatArray
from labhil.tui.chart_heading import chart_heading
from labhil.tui.curve import PlotCurve, draw_curves
from labhil.tui.ticks import Limits, axis_limits, round_ticks, tick_labels

MARGIN = 9
"""Columns on the left for tick labels."""
FRAME = 2
"""Columns, and rows, of the frame around the curves; one more row under it is for the ticks of x."""

ZOOM, WHEEL_ZOOM, MOVE = 0.15, 0.05, 0.1
"""Share of the view that a key or the wheel cuts off at each side, and by which a key moves it."""

PLOT_HELP = """\
**Plots**: Tab moves to a plot, and to the next one. There + and - zoom, the arrows move the view,
shift+right and shift+left put a cursor whose values are in the title, and 0 shows all again. A click puts
the cursor too; then the wheel zooms.
"""
"""Help of screens with plots: a plot has its keys only while it has the focus."""

View = tuple[Limits, Limits]


class Plot(Widget, can_focus=True):
    """Draw curves with their axes; the lines are made once for a view, not for each refresh."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {"plot--axis", "plot--tick"}
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("plus", "zoom(1)", "Zoom", id="plot.in", key_display="+ -", tooltip="Zoom in and out"),
        Binding("minus", "zoom(-1)", "Zoom out", id="plot.out", key_display="-", show=False),
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
        Binding("0", "whole", "Whole", id="plot.whole", tooltip="Undo zooming and moving"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._curves: tuple[PlotCurve, ...] = ()
        self._full_view: View = ((0.0, 1.0), (-1.0, 1.0))
        self._view = self._full_view
        self._lines: list[Strip] = []
        self.cursor: float | None = None
        """Position on x where the values are read; None for none."""

    @dataclass
    class CursorMoved(Message):
        """Report a new position of the cursor on x."""

        x: float | None

    @property
    def view(self) -> View:
        """The visible limits of x and of y."""
        return self._view

    def show(self, curves: Sequence[PlotCurve], x: Limits, y: Limits, *, keep_view: bool = False) -> None:
        """Draw curves.

        Args:
            curves: The curves.
            x: Limits of x.
            y: Limits of y.
            keep_view: Whether a zoomed view stays as it is.
        """
        is_zoomed = self._view != self._full_view
        self._curves, self._full_view = tuple(curves), (_widen(x), _widen(y))
        self._set_view(self._view if keep_view and is_zoomed else self._full_view)

    def notify_style_update(self) -> None:
        """Draw again in the colours of another theme."""
        super().notify_style_update()
        self._set_view(self._view)

    def on_resize(self, _event: Resize) -> None:
        """Draw again in the new size."""
        self._set_view(self._view)

    def _set_view(self, view: View) -> None:
        self._view, self._lines = view, []
        self.refresh()

    def render_lines(self, crop: Region) -> list[Strip]:
        """Return the requested part of the lines; there is no border and no padding."""
        width, height = self.size
        if not self._lines:
            self._lines = self._render_picture(width - MARGIN - FRAME, height - FRAME - 1)
        lines = self._lines[crop.y : crop.bottom]
        return lines if crop.width == width else [line.crop(crop.x, crop.right) for line in lines]

    def _render_picture(self, columns: int, rows: int) -> list[Strip]:
        """Every line, as wide as the widget, with the terminal's filters applied."""
        base, (width, height) = self.rich_style, self.size
        strips = self._frame(columns, rows, base) if columns > 0 and rows > 0 else [Strip.blank(0)] * height
        lines = [line.adjust_cell_length(width, base) for line in strips]
        background = self.background_colors[1]
        for line_filter in self.app.get_line_filters():
            lines = [line.apply_filter(line_filter, background) for line in lines]
        return lines

    def _frame(self, columns: int, rows: int, base: Style) -> list[Strip]:
        colours = self.app.theme_variables
        axis = base + self.get_component_rich_style("plot--axis", partial=True)
        tick = base + self.get_component_rich_style("plot--tick", partial=True)
        pens = [base + Style(color=colours.get(curve.colour, "#888888")) for curve in self._curves]
        raster = draw_curves(self._curves, *self._view, columns, rows)
        x_labels, y_labels = self._ticks_of_x(columns), self._ticks_of_y(rows)
        margin, cursor = Segment(" " * (MARGIN - 1), tick), self._cursor_column(columns)
        lines = [Strip([margin, Segment(" " + _edge("┏", "━", "┻", "┓", columns, x_labels), axis)])]
        for row in range(rows):
            label, left, right = (y_labels[row], "┫", "┣") if row in y_labels else ("", "┃", "┃")
            cells = [Segment(text, pens[owner] if owner >= 0 else base) for text, owner in raster.runs(row)]
            head = [Segment(label.rjust(MARGIN - 1)[: MARGIN - 1], tick), Segment(f" {left}", axis)]
            if cursor is not None:
                strip = Strip(cells)
                mark = Strip([Segment("│", tick)])
                cells = list(Strip.join([strip.crop(0, cursor), mark, strip.crop(cursor + 1)]))
            lines.append(Strip([*head, *cells, Segment(right, axis)]))
        lines.append(Strip([margin, Segment(" " + _edge("┗", "━", "┳", "┛", columns, x_labels), axis)]))
        lines.append(Strip([Segment(_under(x_labels, MARGIN + FRAME + columns), tick)]))
        return lines

    def _ticks_of_x(self, columns: int) -> dict[int, str]:
        """Labels below the columns."""
        low, high = self._view[0]
        values = round_ticks(low, high, max(2, min(10, columns // 9)))
        positions = [round((tick - low) / (high - low) * (columns - 1)) for tick in values]
        return dict(zip(positions, tick_labels(values), strict=True))

    def _ticks_of_y(self, rows: int) -> dict[int, str]:
        """Labels beside the rows."""
        low, high = self._view[1]
        values = round_ticks(low, high, max(1, min(6, rows // 3)))
        positions = [round((high - tick) / (high - low) * (rows - 1)) for tick in values]
        return dict(zip(positions, tick_labels(values), strict=True))

    def _cursor_column(self, columns: int) -> int | None:
        """Column of the cursor; None where it is out of view."""
        (low, high), x = self._view[0], self.cursor
        return None if x is None or not low <= x <= high else round((x - low) / (high - low) * (columns - 1))

    # zooming and moving

    def action_whole(self) -> None:
        """Show the full view, without a cursor."""
        self._set_cursor(None)
        self._set_view(self._full_view)

    def action_cursor(self, step: int) -> None:
        """Move the cursor by a column; at first it appears in the middle."""
        columns, (low, high) = self.size.width - MARGIN - FRAME, self._view[0]
        column = self._cursor_column(columns)
        if columns > 1:
            column_index = columns // 2 if column is None else min(max(column + step, 0), columns - 1)
            self._set_cursor(low + (high - low) * column_index / (columns - 1))

    def on_click(self, event: Click) -> None:
        """Put the cursor where the mouse was clicked."""
        columns, (low, high) = self.size.width - MARGIN - FRAME, self._view[0]
        column_index = event.x - MARGIN - 1
        if columns > 1 and 0 <= column_index < columns:
            self._set_cursor(low + (high - low) * column_index / (columns - 1))

    def _set_cursor(self, x: float | None) -> None:
        if x != self.cursor:
            self.cursor = x
            self.post_message(self.CursorMoved(x))
            self._set_view(self._view)

    def action_zoom(self, step: int) -> None:
        """Zoom about the middle."""
        self._zoom(ZOOM * step, 0.5, 0.5)

    def action_move(self, right: int, up: int) -> None:
        """Shift the view."""
        self._move(MOVE * right, MOVE * up)

    def _zoom(self, share: float, right: float, up: float) -> None:
        """Zoom about a point of the view, given as shares from the left and from below."""
        centre = (right, up)
        limits = [
            (low + 2 * at * share * (high - low), high - 2 * (1 - at) * share * (high - low))
            for (low, high), at in zip(self._view, centre, strict=True)
        ]
        if all(
            low + abs(low) * 1e-9 < high for low, high in limits
        ):  # as far as floating-point numbers resolve
            self._set_view((limits[0], limits[1]))

    def _move(self, right: float, up: float) -> None:
        (x0, x1), (y0, y1) = self._view
        dx, dy = right * (x1 - x0), up * (y1 - y0)
        self._set_view(((x0 + dx, x1 + dx), (y0 + dy, y1 + dy)))

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
        """Drag the view."""
        columns, rows = self.size.width - MARGIN - FRAME, self.size.height - FRAME - 1
        if event.button == 1 and columns > 0 and rows > 0:
            self._move(-event.delta_x / columns, event.delta_y / rows)


class Chart(Vertical):
    """Show a title with the legend, and the plot below."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:  # noqa: A002
        super().__init__(id=id, classes=classes)
        self._heading = Static("", classes="chart-title")
        self._plot = Plot()
        self._curves: tuple[PlotCurve, ...] = ()
        self._title, self._value = Text(), Text()
        self._rows = 1

    def compose(self) -> ComposeResult:
        """Lay out title and plot."""
        yield self._heading
        yield self._plot

    def on_mount(self) -> None:
        """Show the title that was set before, and follow changes of the theme."""
        self.app.theme_changed_signal.subscribe(self, lambda _theme: self._update_heading())
        self._update_heading()

    def on_resize(self, _event: Resize) -> None:
        """Lay out the title in the new width."""
        self._update_heading()

    def show(
        self,
        title: str | Text,
        curves: Sequence[PlotCurve],
        x: Limits | None = None,
        y: Limits | None = None,
        *,
        value: Text | None = None,
        keep_view: bool = False,
    ) -> None:
        """Draw curves under a title.

        Args:
            title: The title.
            curves: The curves.
            x: Limits of x; None for those of the points.
            y: Limits of y; None for those of the points.
            value: Text after the title that is never left out.
            keep_view: Whether a zoomed view stays as it is.
        """
        self._title = Text(title) if isinstance(title, str) else title
        self._value = Text() if value is None else value
        self._curves = tuple(curves)
        span = x or _span([curve.x for curve in curves])
        self._plot.show(curves, span, y or axis_limits([curve.y for curve in curves]), keep_view=keep_view)
        if self.is_mounted:
            self._update_heading()

    def on_plot_cursor_moved(self, message: Plot.CursorMoved) -> None:
        """Show the values at the cursor."""
        message.stop()
        self._update_heading()

    def _update_heading(self) -> None:
        x, columns = self._plot.cursor, self._heading.content_size.width
        if x is None:
            legend = [self._entry(curve, curve.label) for curve in self._curves if curve.label]
            entries = [self._value, *legend] if self._value else legend
            heading = chart_heading(self._title, entries, columns)
        else:
            values = [self._entry(curve, _value_at(curve, x), "bold") for curve in self._curves]
            title = Text.assemble(self._title, (f" at {x:.4g}:", "bold"))
            heading = chart_heading(title, values, columns, gap="  ")
        rows = heading.plain.count("\n") + 1
        if rows != self._rows:
            self._rows = rows
            self._heading.styles.height = rows
        self._heading.update(heading, layout=False)

    def _entry(self, curve: PlotCurve, text: str, style: str = "") -> Text:
        """The pen of a curve, and a text."""
        colour = self.app.theme_variables.get(curve.colour, "#888888")
        return Text.assemble((f"{curve.pen.value} ", colour), (text, style or colour))


def _value_at(curve: PlotCurve, x: float) -> str:
    """Value of the point nearest to ``x``; a dash where there is none, or a break."""
    if not len(curve.x):
        return NOTHING
    value = float(curve.y[int(np.argmin(np.abs(curve.x - x)))])
    return f"{value:.4g}".replace("-", "−") if np.isfinite(value) else NOTHING


def _span(arrays: Sequence[FloatArray]) -> Limits:
    filled = [array for array in arrays if len(array)]
    if not filled:
        return 0.0, 1.0
    return min(float(a.min()) for a in filled), max(float(a.max()) for a in filled)


def _widen(limits: Limits) -> Limits:
    """Limits, moved apart where they coincide."""
    low, high = limits
    return limits if high > low else (low - 0.5, high + 0.5)


def _edge(left: str, line: str, tick: str, right: str, columns: int, x_labels: dict[int, str]) -> str:
    return left + "".join(tick if column in x_labels else line for column in range(columns)) + right


def _under(x_labels: dict[int, str], width: int) -> str:
    """The labels of the ticks of x, each centred under its tick; one without room is left out."""
    line, free = "", 0
    for column, label in x_labels.items():
        start = min(MARGIN + 1 + column - len(label) // 2, width - len(label))
        if start >= free:
            line = line.ljust(start) + label
            free = len(line) + 1
    return line
