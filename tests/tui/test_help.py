"""The help of a screen with plots says how their keys are reached: they are bound on a focused plot only."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest
from textual.widgets import HelpPanel, Markdown

from labhil.tui.app import LabApp

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

SETTLED = 0.15
WITH_PLOTS = {
    "live": ["2"],
    "a recording": ["4", "enter"],
    "results": ["5"],
    "an overlay": ["5", "down", "o"],
}


def help_of(folder: Path, *keys: str) -> str:
    async def go() -> str:
        app = LabApp(folder, StillLab())  # type: ignore[arg-type]
        async with app.run_test(size=(160, 50)) as pilot:
            for key in (*keys, "question_mark"):
                await pilot.press(key)
                await pilot.pause(SETTLED)
                await app.workers.wait_for_complete()
                await pilot.pause(SETTLED)
            panel = app.screen.query_one(HelpPanel)
            return panel.query_one(Markdown).source if panel.has_class("-show-help") else ""

    return asyncio.run(go())


@pytest.mark.parametrize("name", WITH_PLOTS)
def test_the_help_says_how_to_zoom_and_to_read_a_plot(name: str, folder: Path) -> None:
    text = help_of(folder, *WITH_PLOTS[name])
    assert "Tab moves to a plot" in text
    assert all(key in text for key in ("+ and - zoom", "shift+right", "0 shows all"))
    assert ("press z" in text) == (name == "live")


def test_the_help_of_a_screen_without_plots_does_not_speak_of_them(folder: Path) -> None:
    assert help_of(folder, "1") == ""
