"""Tabs and keys of the terminal UI, with the mouse."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

from rich.text import Text
from textual.events import MouseScrollDown
from textual.pilot import Pilot
from textual.widgets import HelpPanel

from labhil.tui.app import LabApp
from labhil.tui.footer import KeyFooter
from labhil.tui.panes import TabbedPanes

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

Walk = Callable[[Pilot[None], LabApp], Awaitable[None]]


def walk(folder: Path, width: int, way: Walk) -> None:
    async def go() -> None:
        app = LabApp(folder, StillLab())  # type: ignore[arg-type]
        async with app.run_test(size=(width, 24)) as pilot:
            await pilot.pause()
            await way(pilot, app)

    asyncio.run(go())


def written(app: LabApp) -> str:
    """The row of keys."""
    line = app.screen.query_one(KeyFooter).render()
    assert isinstance(line, Text)
    return line.plain


async def wait_for(pilot: Pilot[None], app: LabApp, key: str) -> None:
    """Until the folder is read and this key is shown."""
    while key not in written(app):
        await pilot.pause(0.05)


def test_a_click_on_a_tab_brings_its_pane_to_the_front(folder: Path) -> None:
    async def way(pilot: Pilot[None], app: LabApp) -> None:
        await pilot.click("Tab#recordings")
        await pilot.pause()
        panes = app.base.query_one(TabbedPanes).panes
        shown = [name for name, pane in panes.items() if pane.display]
        assert (app.tab, shown) == ("recordings", ["recordings"])

    walk(folder, 100, way)


def test_a_click_on_a_key_is_the_key(folder: Path) -> None:
    async def way(pilot: Pilot[None], app: LabApp) -> None:
        await pilot.pause()
        await pilot.click(KeyFooter, offset=(written(app).index("Keys"), 0))
        await pilot.pause()
        assert app.screen.query(HelpPanel)

    walk(folder, 100, way)


def test_the_wheel_brings_keys_that_have_no_room(folder: Path) -> None:
    async def way(pilot: Pilot[None], app: LabApp) -> None:
        await pilot.press("4")
        await wait_for(pilot, app, "CSV")
        footer, before = app.screen.query_one(KeyFooter), written(app)
        for _ in range(50):
            footer.post_message(MouseScrollDown(footer, 0, 0, 0, 0, 0, False, False, False))
        await pilot.pause()
        assert len(before) > 60
        assert written(app) == before[-60:]

    walk(folder, 60, way)
