"""Tabs and keys of the terminal UI, with the mouse."""

from __future__ import annotations

import asyncio
import importlib
import pkgutil
import sys
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import pytest
from rich.text import Text
from textual.binding import Binding
from textual.events import MouseScrollDown, MouseScrollUp
from textual.pilot import Pilot
from textual.screen import ModalScreen
from textual.widgets import HelpPanel, Tab

import labhil.tui
from labhil.tui.app import LabApp
from labhil.tui.experiment import ExperimentPane
from labhil.tui.footer import KeyFooter
from labhil.tui.live import LivePane
from labhil.tui.overlay import ModelsScreen, Overlay
from labhil.tui.panes import TabbedPanes
from labhil.tui.plot import Plot
from labhil.tui.recording import RecordingScreen
from labhil.tui.recordings import RecordingsPane
from labhil.tui.recordings_overlay import RecordingsOverlay
from labhil.tui.results import ResultsPane

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


def scroll(footer: KeyFooter, way: type[MouseScrollDown | MouseScrollUp], turns: int) -> None:
    for _ in range(turns):
        footer.post_message(way(footer, 0, 0, 0, 0, 0, False, False, False))


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
        await wait_for(pilot, app, "Mark")
        footer, before = app.screen.query_one(KeyFooter), written(app)
        scroll(footer, MouseScrollDown, 50)
        await pilot.pause()
        after = written(app)
        scroll(footer, MouseScrollUp, 50)
        await pilot.pause()
        assert before == " space Mark  t Test  f Fit  d Diagnose  …   ? Keys  q Quit "
        assert after == " …   d Diagnose  h How  v Verify  x CSV  ? Keys  q Quit "
        assert written(app) == before

    walk(folder, 60, way)


def test_a_click_on_the_ellipsis_brings_the_next_key_and_the_one_before(folder: Path) -> None:
    async def way(pilot: Pilot[None], app: LabApp) -> None:
        await pilot.press("4")
        await wait_for(pilot, app, "Mark")
        before = written(app)
        await pilot.click(KeyFooter, offset=(before.index("…"), 0))
        await pilot.pause()
        assert written(app).startswith(" …   t Test ")
        await pilot.click(KeyFooter, offset=(1, 0))
        await pilot.pause()
        assert written(app) == before

    walk(folder, 60, way)


@pytest.mark.extended
@pytest.mark.parametrize("width", [48, 72, 80])
def test_no_key_is_cut_and_those_of_the_application_stay(folder: Path, width: int) -> None:
    async def way(pilot: Pilot[None], app: LabApp) -> None:
        for tab in "12345":
            await pilot.press(tab)
            await pilot.pause(0.3)
            row = written(app)
            assert len(row) <= width
            assert row.endswith("? Keys  q Quit ")
        await pilot.press("4", "space", "down", "space", "f12")
        await pilot.pause(0.5)
        assert written(app).endswith("f9 Release  ? Keys  q Quit ")
        await pilot.press("enter")
        await pilot.pause(0.5)
        assert len(written(app)) <= width
        assert "esc Back" in written(app)

    walk(folder, width, way)


def test_without_room_only_the_tab_in_front_has_its_whole_title(folder: Path) -> None:
    async def way(pilot: Pilot[None], app: LabApp) -> None:
        def titles() -> list[str]:
            return [tab.label_text for tab in app.base.query(Tab)]

        assert titles() == ["1 Devices", "2", "3", "4", "5"]
        await pilot.press("4")
        await pilot.pause()
        assert titles() == ["1", "2", "3", "4 Recordings", "5"]
        await pilot.resize_terminal(80, 24)
        await pilot.pause()
        assert titles() == ["1 Devices", "2 Live", "3 Experiment", "4 Recordings", "5 Results"]

    walk(folder, 50, way)


def bindings_of(owner: type) -> Iterator[tuple[str, str]]:
    """Each key of a class, with what it does."""
    for binding in owner.BINDINGS:
        assert isinstance(binding, Binding)
        for key in binding.key.split(","):
            yield key, binding.description


def owners_of_keys() -> Iterator[type]:
    """The app, its tabs, the screens over them, and plots; a dialog says its keys beside its choices."""
    for module in pkgutil.iter_modules(labhil.tui.__path__, "labhil.tui."):
        for name, owner in vars(importlib.import_module(module.name)).items():
            is_own = isinstance(owner, type) and owner.__module__ == module.name and "BINDINGS" in vars(owner)
            if is_own and not name.startswith("_") and not issubclass(owner, ModalScreen):
                yield owner


def test_a_key_has_one_meaning_on_all_tabs_and_screens() -> None:
    owners = set(owners_of_keys())
    tabs = {LabApp, LivePane, ExperimentPane, RecordingsPane, ResultsPane}
    assert owners >= tabs | {Overlay, ModelsScreen, RecordingScreen, RecordingsOverlay, Plot}
    meanings: dict[str, set[str]] = {}
    for owner in owners:
        for key, meaning in bindings_of(owner):
            meanings.setdefault(key, set()).add("Leave" if meaning in ("Back", "Quit") else meaning)
    assert meanings["m"] == {"Mark"}
    assert meanings["b"] == {"Model"}
    assert {key: found for key, found in meanings.items() if len(found) > 1} == {}
