"""The heading of a chart: one line or two, and no word of it cut."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from rich.text import Text
from textual.app import App, ComposeResult
from textual.widgets import Static

from labhil.tui.chart_heading import chart_heading, whole_words
from labhil.tui.curve import PlotCurve, column_curves
from labhil.tui.plot import Chart, Plot

TITLE = "what has no name on joint 2, N·m, over ball_velocity"
LEGEND = ("━━ estimate", "·· 99 % band", "╍╍ before")


def heading(columns: int) -> list[str]:
    return chart_heading(Text(TITLE), [Text(entry) for entry in LEGEND], columns).plain.splitlines()


def test_all_stands_in_one_line_where_it_has_room() -> None:
    assert heading(100) == [TITLE + "   " + "   ".join(LEGEND)]
    assert heading(0) == heading(100)


def test_the_legend_takes_a_line_of_its_own_where_it_has_none() -> None:
    assert heading(60) == [TITLE, "   ".join(LEGEND)]


@pytest.mark.parametrize("columns", range(12, 100))
def test_no_word_and_no_entry_is_cut(columns: int) -> None:
    lines = heading(columns)
    assert all(Text(line).cell_len <= columns for line in lines)
    if len(lines) == 2:
        title, legend = lines
        assert set(title.rstrip("…").split()) <= set(TITLE.replace(",", "").split()) | set(TITLE.split())
        assert set(legend.split("   ")) <= {*LEGEND, "…"}
        assert (title == TITLE) or title.endswith("…")


def test_a_word_longer_than_the_line_is_cut_with_an_ellipsis() -> None:
    assert whole_words(Text("acceleration"), 8).plain == "acceler…"
    assert whole_words(Text("a long, long way"), 9).plain == "a long…"


def test_a_vector_has_the_numbers_of_its_columns_in_its_legend() -> None:
    curves = column_curves(np.arange(3.0), np.zeros((3, 6)), 6, 0, 1.0)
    assert [curve.label for curve in curves] == ["0", "1", "2", "3", "4", "5"]
    assert [curve.label for curve in column_curves(np.arange(3.0), np.zeros((3, 1)), 1, 0, 1.0)] == [""]


def test_a_chart_gives_its_heading_a_second_line_and_takes_it_back() -> None:
    class OneChart(App[None]):
        CSS = "Plot { height: 1fr; }"

        def compose(self) -> ComposeResult:
            yield Chart()

    async def go() -> None:
        app = OneChart()
        async with app.run_test(size=(60, 20)) as pilot:
            chart = app.query_one(Chart)
            x = np.linspace(0.0, 1.0, 20)
            chart.show(TITLE, [PlotCurve(x, x, label="estimate"), PlotCurve(x, -x, label="99 % band")])
            await pilot.pause()
            assert (app.query_one(Static).size.height, app.query_one(Plot).size.height) == (2, 18)
            await pilot.resize_terminal(120, 20)
            await pilot.pause()
            assert (app.query_one(Static).size.height, app.query_one(Plot).size.height) == (1, 19)

    asyncio.run(go())
