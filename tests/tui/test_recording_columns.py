"""The list of recordings and that of results: what has no room is left out or ends in an ellipsis."""

from __future__ import annotations

import asyncio
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import pytest
from textual.widgets import DataTable

from labhil.tui.app import LabApp
from labhil.tui.recording_columns import COLUMNS, PADDING, cells, fit_columns, row_of
from labhil.tui.recording_library import LibraryEntry
from labhil.tui.recordings import RecordingsPane

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

SETTLED = 0.15
COLOURS = defaultdict(lambda: "#ffffff")
FAILED = LibraryEntry(
    Path("two_sine_identify_with_a_longer_name-2026-11-28-17.mcap"),
    123_456_789,
    1_790_000_000.0,
    "ball_beam",
    725.0,
    1_234_567,
    12_345,
    "failed (130)",
    "ball_position 0.26 m is beyond its limit of 0.24 m",
)


def rows(app: LabApp) -> list[str]:
    return ["".join(segment.text for segment in strip) for strip in app.screen._compositor.render_strips()]


@pytest.mark.parametrize("room", [40, 48, 60, 78, 98, 118, 158])
def test_columns_that_have_no_room_are_left_out(room: int) -> None:
    row = row_of(FAILED, "+", COLOURS)
    widths = fit_columns([row], room)
    assert sum(widths.values()) + PADDING * len(widths) <= room
    shown = dict(zip(widths, cells(row, widths), strict=True))
    for key, cell in shown.items():
        assert key == "reason" or cell.cell_len <= widths[key]
    assert shown["status"].plain == "✕ failed (130)"
    assert room == 40 or shown["gaps"].plain == "12\u202f345"
    assert "…" in shown["name"].plain
    assert shown["name"].plain.endswith("-11-28-17")
    assert list(widths) == [key for key in COLUMNS if key in widths]


def test_a_list_of_recordings_shows_no_half_words(folder: Path) -> None:
    async def go() -> list[str]:
        app = LabApp(folder, StillLab(), tab="recordings")  # type: ignore[arg-type]
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.pause(SETTLED)
            await pilot.app.workers.wait_for_complete()
            await pilot.pause(SETTLED)
            pane = app.query_one(RecordingsPane)
            pane.show_entries([FAILED, replace(FAILED, path=Path("b.mcap"), status="done")])
            app.query_one("#recordings-table", DataTable).focus()
            await pilot.pause(SETTLED)
            await pilot.press("down")
            pane.show_entries([FAILED, replace(FAILED, path=Path("b.mcap"), status="growing")])
            await pilot.pause(SETTLED)
            assert app.query_one("#recordings-table", DataTable).cursor_row == 1
            return rows(app)

    shown = asyncio.run(go())
    assert "✕ failed (130)" in shown[4]
    assert "-11-28-17" in shown[4]
    assert "● growing" in shown[5]


def test_a_result_without_room_ends_in_an_ellipsis(folder: Path) -> None:
    async def go() -> tuple[list[str], list[str]]:
        app = LabApp(folder, StillLab(), tab="results")  # type: ignore[arg-type]
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.press("down")
            await pilot.pause(SETTLED)
            small = rows(app)
            await pilot.resize_terminal(160, 50)
            await pilot.pause(SETTLED)
            assert app.query_one("#results-table", DataTable).cursor_row == 1
            return small, rows(app)

    small, large = asyncio.run(go())
    assert small[4].rstrip().endswith("stri…")
    assert small[5].rstrip().endswith("parame…")
    assert large[5].rstrip().endswith("9 parameters")
