"""Every screen as a picture, small and large, from fixed data and with clocks that stand.

``LABHIL_DRAW_SCREENS=1 pytest tests/tui/test_screens.py -m ''`` draws them anew; look at each of them
before you keep it.
"""

from __future__ import annotations

import asyncio
import gzip
import os
import shutil
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input

from labhil.bus.incoming import ReplayMessage
from labhil.tui import clock, shadow
from labhil.tui.analysis import AnalysisDialog
from labhil.tui.app import LabApp
from labhil.tui.overlay import ModelsScreen, OverlayScreen
from labhil.tui.shadow import ShadowView
from labhil.tui.themes import DARK, LIGHT

sys.path.insert(0, str(Path(__file__).parent))

from shadowed import StillHelper
from still import NOW_NS, StillLab

SCREENS = Path(__file__).parent / "screens"
PICTURES = Path(__file__).parents[2] / "docs" / "tui"
COMPARED = Path(__file__).parent / "compared" / "ball_beam_identify.comparison.json"
VERIFIED = Path(__file__).parent / "compared" / "ball_beam_test.verification.json"
NEWEST = 1_790_000_100.0
LIGHT_TOO = ("devices", "live", "experiment", "recordings", "recording", "results", "fit", "charts", "models")
OFTEN = ("devices", "live", "experiment", "results")
SMALL, LARGE = (80, 24), (160, 50)
SETTLED = 0.15

Go = Callable[[Pilot[None], LabApp], Awaitable[None]]


def keys(*pressed: str) -> Go:
    async def go(pilot: Pilot[None], _app: LabApp) -> None:
        for key in pressed:
            await pilot.press(key)
            await settle(pilot)

    return go


async def running(pilot: Pilot[None], app: LabApp) -> None:
    runner = app.runner
    runner.state, runner.name, runner.elapsed, runner.duration = "running", "two-sine-identify", 23.4, 60.0
    await keys("3")(pilot, app)


async def stopped(pilot: Pilot[None], app: LabApp) -> None:
    await keys("1", "f12")(pilot, app)


async def stopped_elsewhere(pilot: Pilot[None], app: LabApp) -> None:
    """On a screen above the tabs, where the stop has to be as visible."""
    await keys("4", "enter", "f12")(pilot, app)


async def release(pilot: Pilot[None], app: LabApp) -> None:
    await keys("1", "f12", "f9")(pilot, app)


async def replayed(pilot: Pilot[None], app: LabApp) -> None:
    app.session.replay = ReplayMessage(  # type: ignore[attr-defined]
        path="ball_beam_identify.mcap", position=23.4, duration=60.0, speed=2.0, paused=False, ended=False
    )
    await keys("2")(pilot, app)


async def analysis(pilot: Pilot[None], app: LabApp) -> None:
    """With the catalogue read, which takes a process of its own some seconds."""
    await keys("4", "h")(pilot, app)
    dialog = app.screen
    assert isinstance(dialog, AnalysisDialog)
    while dialog.catalogue is None:
        await pilot.pause(SETTLED)
    await keys("s", "s", "down", "down")(pilot, app)


async def overlay(pilot: Pilot[None], app: LabApp) -> None:
    """Without Coulomb friction, which is simulated in a process of its own, and with the cursor."""
    await keys("5", "down", "o")(pilot, app)
    screen = app.screen
    assert isinstance(screen, OverlayScreen)
    while screen.shown is None:
        await pilot.pause(SETTLED)
    await keys("down", "space")(pilot, app)
    while screen.shown != {"coulomb_friction"}:
        await pilot.pause(SETTLED)


async def cursor(pilot: Pilot[None], app: LabApp) -> None:
    await overlay(pilot, app)
    await keys("tab", "plus", "plus", "shift+right", "shift+right")(pilot, app)


async def shadowed(pilot: Pilot[None], app: LabApp) -> None:
    """A model that agrees for a while, and then does not."""
    await keys("2", "b", "enter")(pilot, app)
    view = app.base.query_one(ShadowView)
    while view.state is None or len(view.state.outputs["ball_position"].stretches) < 10:
        await pilot.pause(SETTLED)
    await settle(pilot)
    view.parent.parent.draw()  # type: ignore[union-attr]
    await pilot.pause(SETTLED)


async def compared(pilot: Pilot[None], app: LabApp) -> None:
    """A comparison in the list of results, as the newest."""
    copy = app.folder / COMPARED.name
    shutil.copy(COMPARED, copy)
    os.utime(copy, (NEWEST, NEWEST))
    await keys("5", "home")(pilot, app)


async def next_steps(pilot: Pilot[None], app: LabApp) -> None:
    """The end of a fit, with what to do next."""
    await keys("5", "down")(pilot, app)
    app.base.query_one("#result-scroll").scroll_end(animate=False)


async def verified(pilot: Pilot[None], app: LabApp) -> None:
    """A verification in the list of results, as the newest, with what to do next."""
    copy = app.folder / VERIFIED.name
    shutil.copy(VERIFIED, copy)
    os.utime(copy, (NEWEST, NEWEST))
    await keys("5", "home")(pilot, app)


async def marked(pilot: Pilot[None], app: LabApp) -> None:
    """Two models that are to be compared."""
    await keys("5", "space", "down", "space")(pilot, app)


async def models(pilot: Pilot[None], app: LabApp) -> None:
    """What two models of one recording err by, looked at closely."""
    await keys("5", "space", "down", "space", "o")(pilot, app)
    screen = app.screen
    assert isinstance(screen, ModelsScreen)
    while screen.shown is None:
        await pilot.pause(SETTLED)
    await keys("u", "tab", "plus", "plus")(pilot, app)


async def palette(pilot: Pilot[None], _app: LabApp) -> None:
    """With the first experiment's plan read: what the palette offers depends on it."""
    await pilot.press("3")
    await settle(pilot)
    await pilot.press("1", "ctrl+p")


SHOWN: dict[str, Go] = {
    "devices": keys("1"),
    "live": keys("2"),
    "shadow": shadowed,
    "replay": replayed,
    "experiment": running,
    "recordings": keys("4", "space", "down", "t"),
    "recording": keys("4", "enter"),
    "results": keys("5"),
    "fit": keys("5", "down"),
    "charts": keys("5", "g"),
    "compared": compared,
    "marked": marked,
    "stopped": stopped,
    "stopped-elsewhere": stopped_elsewhere,
    "overlaid": keys("4", "space", "down", "space", "o"),
    "release": release,
    "verify": keys("4", "v"),
    "verified": verified,
    "steps": next_steps,
    "analysis": analysis,
    "overlay": overlay,
    "models": models,
    "cursor": cursor,
    "keys": keys("4", "question_mark"),
    "palette": palette,
}
DOCUMENTED = {
    "devices-80x24": "devices",
    "live-160x50": "live",
    "live-80x24-light": "light",
    "shadow-80x24": "shadow",
    "replay-80x24": "replay",
    "experiment-160x50": "experiment",
    "recordings-80x24": "recordings",
    "recording-160x50": "recording",
    "results-160x50": "results",
    "fit-160x50": "fit",
    "compared-160x50": "compared",
    "stopped-80x24": "stopped",
    "release-80x24": "release",
    "verify-80x24": "verify",
    "analysis-80x24": "analysis",
    "overlay-160x50": "overlay",
    "models-160x50": "models",
    "keys-80x24": "keys",
    "palette-80x24": "palette",
}
"""Which of these pictures stand in docs/tui, under what name."""


async def settle(pilot: Pilot[None]) -> None:
    """Wait until threads have told what they read and all of it is drawn."""
    await pilot.pause(SETTLED)
    await pilot.app.workers.wait_for_complete()
    await pilot.pause(SETTLED)


async def picture(folder: Path, go: Go, size: tuple[int, int], theme: str, empty: bool = False) -> str:
    app = LabApp(folder, StillLab(empty=empty), theme=theme)  # type: ignore[arg-type]
    async with app.run_test(size=size) as pilot:
        await settle(pilot)
        await go(pilot, app)
        await settle(pilot)
        return app.export_screenshot()


def check(name: str, found: str, tmp_path: Path) -> None:
    """Compare with the picture that is kept; where they differ, leave both to be looked at."""
    kept = SCREENS / f"{name}.svg.gz"
    if os.environ.get("LABHIL_DRAW_SCREENS"):
        kept.write_bytes(gzip.compress(found.encode(), mtime=0))
        if name in DOCUMENTED:
            (PICTURES / f"{DOCUMENTED[name]}.svg").write_text(found, encoding="utf-8")
    expected = gzip.decompress(kept.read_bytes()).decode()
    if found != expected:
        was, now = tmp_path / f"{name}.was.svg", tmp_path / f"{name}.now.svg"
        was.write_text(expected, encoding="utf-8")
        now.write_text(found, encoding="utf-8")
        pytest.fail(f"{name} looks different: expected {was}, found {now}")


@pytest.fixture(autouse=True)
def clocks_stand_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "clock_ns", lambda: NOW_NS)
    monkeypatch.setattr(shadow, "Helper", StillHelper)
    monkeypatch.setattr(Input, "_toggle_cursor", lambda _input: None)  # it blinks


def draw(name: str, folder: Path, tmp_path: Path, size: tuple[int, int], theme: str = DARK.name) -> None:
    found = asyncio.run(picture(folder, SHOWN[name], size, theme))
    sort = "" if theme == DARK.name else "-light"
    check(f"{name}-{size[0]}x{size[1]}{sort}", found, tmp_path)


@pytest.mark.parametrize("name", OFTEN)
def test_a_small_terminal_shows_all_that_matters(name: str, folder: Path, tmp_path: Path) -> None:
    draw(name, folder, tmp_path, SMALL)


@pytest.mark.extended
@pytest.mark.parametrize("name", [name for name in SHOWN if name not in OFTEN])
def test_a_small_terminal_shows_the_rest_too(name: str, folder: Path, tmp_path: Path) -> None:
    draw(name, folder, tmp_path, SMALL)


@pytest.mark.extended
@pytest.mark.parametrize("name", SHOWN)
def test_a_large_terminal_uses_its_room(name: str, folder: Path, tmp_path: Path) -> None:
    draw(name, folder, tmp_path, LARGE)


@pytest.mark.extended
@pytest.mark.parametrize("name", LIGHT_TOO)
def test_the_light_theme(name: str, folder: Path, tmp_path: Path) -> None:
    draw(name, folder, tmp_path, SMALL, LIGHT.name)


@pytest.mark.extended
def test_with_nothing_there_the_first_screen_says_what_to_do(folder: Path) -> None:
    found = asyncio.run(picture(folder, keys("1"), SMALL, DARK.name, empty=True))
    assert "Enter" in found


@pytest.mark.parametrize("name", DOCUMENTED)
def test_the_pictures_of_the_documentation_are_of_today(name: str) -> None:
    kept = gzip.decompress((SCREENS / f"{name}.svg.gz").read_bytes()).decode()
    assert (PICTURES / f"{DOCUMENTED[name]}.svg").read_text(encoding="utf-8") == kept
