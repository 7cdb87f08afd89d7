"""The tab of devices: state, rate, lease and newest values of each."""

from __future__ import annotations

from datetime import datetime

from rich.console import Group
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Container, Vertical, VerticalScroll
from textual.events import Resize
from textual.widgets import DataTable, Static

from labhil.report.formatting import NOTHING, format_count
from labhil.tui.bus_watch import REPLAYED, Announcement, DeviceView
from labhil.tui.formatting import (
    PlainTable,
    device_label,
    format_duration,
    format_frequency,
    format_milliseconds,
    plain_grid,
)
from labhil.tui.lists import LabTable
from labhil.tui.panes import Pane
from labhil.tui.session import Session

COLUMNS = (
    ("device", 10),
    ("state", 13),
    ("rate", 9),
    ("gaps", 5),
    ("delay", 8),
    ("held by", 21),
    ("last event", 16),
)
"""Width of each column; the last has what is left, and is not there where that is less than this."""
PADDING = SIDES = 2
"""Blanks around a cell, and on both sides of the table."""

EMPTY = """[b]No device is on a bus here.[/b]

  [b $accent]3[/] then [b $accent]Enter[/]   run the example on a simulated bench
  [b $accent]3[/]              choose an experiment of your own
  [b $accent]4[/]              look at recordings, fit them, diagnose them

[$muted]Devices of any run on this machine appear here by themselves.[/]"""


class DevicesPane(Vertical, Pane):
    """Show a table of devices, and the newest values of the chosen one."""

    MAIN_WIDGET = "#devices-table"

    def __init__(self, session: Session) -> None:
        super().__init__(id="devices-pane")
        self._session = session
        self._shown: tuple[str, ...] = ()
        self._widths: dict[str, int] = {}
        self._row_in_front = 0
        self._shape: object = None

    def compose(self) -> ComposeResult:
        """Lay out the table, the values, and the text for an empty bus."""
        yield Static(EMPTY, id="devices-empty")
        with Container(id="devices-split"):
            yield LabTable(id="devices-table", cursor_type="row", zebra_stripes=False)
            with VerticalScroll(id="device-detail", can_focus=False):
                yield Static(id="device-readings")

    def on_mount(self) -> None:
        """Make the columns."""
        self._fit_columns(0)
        self.refresh_view()

    def on_resize(self, event: Resize) -> None:
        """Give the last event the width that the other columns leave."""
        self._fit_columns(event.size.width)
        self.refresh_view()

    def _fit_columns(self, width: int) -> None:
        """Make the columns anew where the last one has other room than before."""
        *columns, (last, least) = COLUMNS
        left = width - SIDES - sum(width + PADDING for _, width in columns) - PADDING
        widths = dict(columns) | ({last: left} if left >= least else {})
        if widths != self._widths:
            table = self.query_one(DataTable)
            self._widths, self._shown, self._row_in_front = widths, (), table.cursor_row
            table.clear(columns=True)
            for name, column_width in widths.items():
                table.add_column(name, key=name, width=column_width)

    def refresh_view(self) -> None:
        """Show the devices in their present state."""
        devices = self._session.devices()
        self.query_one("#devices-empty").display = not devices
        self.query_one("#devices-split").display = bool(devices)
        table = self.query_one(DataTable)
        keys = tuple(f"{endpoint} {view.name}" for endpoint, view in devices)
        rows = [dict(zip(self._widths, self._row(view), strict=False)) for _, view in devices]
        if keys != self._shown:
            cursor_row = table.cursor_row if self._shown else self._row_in_front
            table.clear()
            for key, row in zip(keys, rows, strict=True):
                table.add_row(*row.values(), key=key)
            table.move_cursor(row=min(cursor_row, max(0, len(keys) - 1)))
            self._shown = keys
        else:
            for key, row in zip(keys, rows, strict=True):
                for column, cell in row.items():
                    if table.get_cell(key, column) != cell:
                        table.update_cell(key, column, cell)
        if devices:
            endpoint, view = devices[min(table.cursor_row, len(devices) - 1)]
            entries = device_facts(endpoint, view)
            # numbers change all the time, the height seldom: a layout costs more than all the rest
            shape = (
                endpoint,
                view.name,
                view.stream,
                self._session.fault,
                [len(value) for _, value in entries[4:]],
            )
            readings = self._readings(view, entries)
            self.query_one("#device-readings", Static).update(readings, layout=shape != self._shape)
            self._shape = shape

    def on_data_table_row_highlighted(self, _event: DataTable.RowHighlighted) -> None:
        """Show the values of the chosen device."""
        if self._shown:
            self.refresh_view()

    def _row(self, view: DeviceView) -> list[Text]:
        colours = self.app.theme_variables
        health = view.health
        stale = view.state == "gone" or health is None or health.silent
        rate = NOTHING if stale or health is None else format_frequency(health.rate)
        delay = NOTHING if stale or health is None else format_milliseconds(health.transit)
        event = NOTHING if view.event is None else format_event(view.event)
        gaps = Text(NOTHING if health is None else format_count(health.gaps))
        if health is not None and health.gaps:
            gaps.stylize(f"bold {colours['warning']}")
        return [
            Text(view.name.removeprefix(REPLAYED), style="bold"),
            device_label(view).text(colours),
            Text(rate),
            gaps,
            Text(delay),
            Text(view.holder or NOTHING, no_wrap=True, overflow="ellipsis"),
            Text(event, style=colours["muted"], no_wrap=True, overflow="ellipsis"),
        ]

    def _readings(self, view: DeviceView, entries: list[tuple[str, str]]) -> Group:
        colours = self.app.theme_variables
        grid = plain_grid()
        grid.add_column(style=colours["muted"], no_wrap=True)
        grid.add_column()
        for name, value in entries:
            grid.add_row(name, value)
        if self._session.fault:
            grid.add_row(Text("▲ fault", style=colours["warning"]), self._session.fault)
        if view.stream is None:
            return Group(grid)
        return Group(*self._values(view), Text(), grid)

    def _values(self, view: DeviceView) -> tuple[Text, PlainTable]:
        """The newest values, marked as live only while samples come in."""
        assert view.stream is not None
        colours = self.app.theme_variables
        stale = view.state == "gone" or view.health is None or view.health.silent
        title = Text(view.name, style="bold")
        if stale:
            age = format_duration(view.health.age if view.health else None)
            title.append(f"  ◌ last known, {age} ago", style=colours["warning"])
        else:
            title.append("  ▶ now", style=colours["success"])
        table = plain_grid()
        table.add_column(style=colours["muted"], no_wrap=True)
        table.add_column(justify="right", no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(style=colours["muted"], no_wrap=True, overflow="ellipsis")
        values = iter(view.last_values)
        for signal in view.stream.signals:
            for column in signal.columns():
                value = next(values, None)
                shown = NOTHING if value is None else f"{value:+.5f}".replace("-", "−")
                style = colours["muted"] if stale else f"bold {colours['primary']}"
                number = Text(f"({shown})" if stale else shown, style=style)
                table.add_row(column, number, signal.unit, signal.description)
        return title, table


def device_facts(endpoint: str, view: DeviceView) -> list[tuple[str, str]]:
    """Return names and values of everything that is known of a device, except its samples.

    Args:
        endpoint: Endpoint of its bus.
        view: The device.
    """
    health, stream = view.health, view.stream
    lines = []
    if stream is not None and health is not None:
        speed = "" if view.speed == 1.0 else f" × {view.speed:g} (its time runs faster)"
        lines.append(("rate", f"{format_frequency(health.rate)} measured, {stream.rate:g} Hz{speed} nominal"))
        lines.append(("delay", f"{format_milliseconds(health.transit)} from acquisition to this screen"))
        lines.append(
            ("jitter", f"{format_milliseconds(health.lateness)} between the quickest and the latest sample")
        )
        lines.append(
            ("samples", f"{format_count(health.received)} seen, {format_count(health.gaps)} missing")
        )
    lines.append(("state", f"{view.state}: {view.reason}" if view.reason else view.state))
    if view.event is not None:
        lines.append(("last event", format_event(view.event)))
    if view.holder and len(view.holder) > dict(COLUMNS)["held by"]:
        lines.append(("held by", view.holder))
    metadata = view.metadata
    if view.is_replayed:
        lines.append(("replay", "no device is there: a recording is played"))
    fields = ("plugin", "address", "firmware", "serial")
    lines += [(name, metadata[name]) for name in fields if metadata.get(name)]
    lines.append(("bus", endpoint))
    return lines


def format_event(event: Announcement) -> str:
    """Return an event in one line."""
    time_of_day = datetime.fromtimestamp(event.t_ns * 1e-9).astimezone().strftime("%H:%M:%S")
    return f"{time_of_day} {event.kind}: {event.message}" if event.message else f"{time_of_day} {event.kind}"
