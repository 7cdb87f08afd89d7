"""The tab of devices: what its table has no room for stands in full below it."""

from __future__ import annotations

import asyncio
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from textual.widgets import DataTable, Static

from labhil.tui.app import LabApp
from labhil.tui.bus_watch import DeviceView

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

CAUSE = "ball_position 0.26 m is beyond its limit of 0.24 m, and the host has made the device safe at once"
HOLDER = "run a-very-long-name-of-an-experiment"


class TrippedLab(StillLab):
    """A lab whose first device has tripped, with much to say."""

    def devices(self) -> list[tuple[str, DeviceView]]:
        (endpoint, view), *others = super().devices()
        assert view.event is not None
        event = replace(view.event, kind="tripped", message=CAUSE)
        return [(endpoint, replace(view, event=event, holder=HOLDER)), *others]


def shown(folder: Path, width: int) -> tuple[list[str], str, str]:
    """The columns of the table, its first row as it is drawn, and the details."""

    async def go() -> tuple[list[str], str, str]:
        app = LabApp(folder, TrippedLab())  # type: ignore[arg-type]
        async with app.run_test(size=(width, 40)) as pilot:
            await pilot.pause(0.2)
            table = app.query_one("#devices-table", DataTable)
            await pilot.press("down")
            await pilot.resize_terminal(width - 1, 40)
            await pilot.pause(0.2)
            assert table.cursor_row == 1
            await pilot.resize_terminal(width, 40)
            await pilot.press("up")
            await pilot.pause(0.2)
            console = Console(width=width - 5, no_color=True, force_terminal=False)
            with console.capture() as details:
                console.print(app.query_one("#device-readings", Static).content)
            names = [str(column.label) for column in table.columns.values()]
            return names, table.render_line(1).text, " ".join(details.get().split())

    return asyncio.run(go())


def test_an_event_without_room_ends_in_an_ellipsis_and_stands_in_full_below(folder: Path) -> None:
    names, row, details = shown(folder, 120)
    assert names[-1] == "last event"
    assert row.rstrip().endswith("…")
    assert CAUSE not in row
    assert f"tripped: {CAUSE}" in details
    assert f"held by {HOLDER}" in details
    assert HOLDER not in row


@pytest.mark.extended
def test_a_small_terminal_has_no_column_for_it_and_shows_it_below(folder: Path) -> None:
    names, row, details = shown(folder, 80)
    assert names[-1] == "held by"
    assert row.rstrip().endswith("…")
    assert f"tripped: {CAUSE}" in details


@pytest.mark.extended
def test_a_large_terminal_shows_it_as_a_whole(folder: Path) -> None:
    _, row, _ = shown(folder, 220)
    assert CAUSE in row
