"""The emergency stop is in sight and in reach on every screen, and in every dialog."""

from __future__ import annotations

import asyncio
import importlib
import pkgutil
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.screen import Screen

import labhil.tui
from labhil.tui.app import LabApp
from labhil.tui.dialogs import Confirm
from labhil.tui.top_bar import TopBar, WithBar

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

SETTLED = 0.15
WAYS = {
    "the tabs": ["4"],
    "a recording": ["4", "enter"],
    "an overlay": ["5", "down", "o"],
    "models": ["5", "space", "down", "space", "o"],
    "a choice of terms": ["4", "h"],
    "a choice of a model": ["4", "v"],
    "the palette": ["ctrl+p"],
}


def rows(app: LabApp) -> list[str]:
    """The text on the screen, row by row, with its colours left out."""
    return ["".join(segment.text for segment in strip) for strip in app.screen._compositor.render_strips()]


def front_colours(app: LabApp, row: int) -> set[str]:
    strip = app.screen._compositor.render_strips()[row]
    return {s.style.bgcolor.name for s in strip if s.text.strip() and s.style is not None and s.style.bgcolor}


async def press(pilot: Pilot[None], *pressed: str) -> None:
    for key in pressed:
        await pilot.press(key)
        await pilot.pause(SETTLED)


async def stopped_and_released(folder: Path, way: list[str]) -> None:
    app = LabApp(folder, StillLab())  # type: ignore[arg-type]
    async with app.run_test(size=(80, 24)) as pilot:
        await press(pilot, *way)
        screen = app.screen
        assert "■ STOP ALL  F12" in rows(app)[0]
        await press(pilot, "f12")
        await pilot.pause(2 * SETTLED)
        assert app.screen is screen
        note = re.sub(r"\s+", " ", " ".join(rows(app)[1:4]))
        assert "EMERGENCY STOP at" in note
        assert "by the terminal UI" in note
        assert "NO PROPER ANSWER from spare: switch the power off." in note
        assert "Safe: bench. F9 releases it." in note
        assert app.theme_variables["stop-background"] in front_colours(app, 1), "the red is not dimmed"
        await press(pilot, "f9")
        assert isinstance(app.screen, Confirm)
        await press(pilot, "f9")
        assert len([s for s in app.screen_stack if isinstance(s, Confirm)]) == 1, "it is asked once"
        await press(pilot, "y")
        await pilot.pause(2 * SETTLED)
        assert app.session.latch is None
        assert not any("EMERGENCY" in row for row in rows(app))


@pytest.mark.parametrize("name", WAYS)
def test_the_stop_shows_and_is_released_on(name: str, folder: Path) -> None:
    asyncio.run(stopped_and_released(folder, WAYS[name]))


def screens() -> Iterator[type[Screen[object]]]:
    for module in pkgutil.iter_modules(labhil.tui.__path__, "labhil.tui."):
        for found in vars(importlib.import_module(module.name)).values():
            if isinstance(found, type) and issubclass(found, Screen) and found.__module__ == module.name:
                yield found


def test_no_screen_is_without_the_bar() -> None:
    without = {found.__name__ for found in screens() if not issubclass(found, WithBar)}
    assert not without


def test_a_screen_has_one_bar_on_top(folder: Path) -> None:
    async def count() -> int:
        app = LabApp(folder, StillLab())  # type: ignore[arg-type]
        async with app.run_test() as pilot:
            await pilot.pause(SETTLED)
            return len(app.screen.query(TopBar))

    assert asyncio.run(count()) == 1
