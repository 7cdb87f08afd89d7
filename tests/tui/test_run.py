"""The screen at work: a real twin, a real run, and every way in which the screen may end."""

from __future__ import annotations

import asyncio
import os
import pty
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL
from textual.events import Hide, Key
from textual.pilot import Pilot
from textual.widgets import DataTable

from labhil.bus.latch import read_latch
from labhil.bus.register import registered_processes
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from labhil.tui.app import LabApp
from labhil.tui.dialogs import Confirm, TextPrompt
from labhil.tui.session import Session

PATIENCE = 100.0
MOVING = 16_384
"""Bytes of a recording that has samples: a run that ends before its device is up leaves none."""

pytestmark = pytest.mark.timeout(300)


async def until(pilot: Pilot[None], condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        await pilot.pause(0.05)


async def in_state(pilot: Pilot[None], app: LabApp, state: str) -> None:
    await until(pilot, lambda: app.runner.state == state)


def pane_has_keys(app: LabApp) -> bool:
    """Whether the next key goes to the screen below the prompt, which takes a moment on a busy machine."""
    return not isinstance(app.screen, TextPrompt) and app.focused is not None


def only_recording(folder: Path) -> Recording:
    (path,) = folder.glob("*.mcap")
    return read_recording(path)


def kinds(recording: Recording, device: str) -> list[str]:
    return [
        str(event.body["kind"])
        for event in recording.events
        if event.device == device and event.topic == "event"
    ]


def test_keys_that_are_typed_ahead_are_for_the_pane_that_they_opened(
    bench: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[Path] = []

    async def drive() -> None:
        with Session(()) as lab:
            app = LabApp(bench, lab)
            monkeypatch.setattr(app.runner, "start", lambda path, _name: started.append(path))
            async with app.run_test(size=(100, 30)) as pilot:
                await pilot.pause(0.3)
                for key, character in (("3", "3"), ("enter", "\r")):
                    app.post_message(Key(key, character))
                await until(pilot, lambda: bool(started))

    asyncio.run(drive())
    assert [path.name for path in started] == ["pilot.toml"]


def test_a_tab_keeps_its_keys_when_a_layout_or_a_click_takes_the_focus_away(bench: Path) -> None:
    async def drive() -> None:
        with Session(()) as lab:
            app = LabApp(bench, lab, tab="recordings")
            async with app.run_test(size=(100, 30)) as pilot:
                for taken_by in ("a layout", "a click"):
                    await until(pilot, lambda: app.focused is app.query_one("#recordings-table"))
                    if taken_by == "a layout":
                        app.query_one("#recordings-table").post_message(Hide())
                    else:
                        await pilot.click("#brand")
                await until(pilot, lambda: app.focused is app.query_one("#recordings-table"))

    asyncio.run(drive())


@pytest.mark.extended
def test_two_keys_start_the_first_experiment_which_can_be_paused_resumed_and_stopped(bench: Path) -> None:
    async def drive() -> None:
        with Session() as lab:
            app = LabApp(bench, lab)
            async with app.run_test(size=(100, 30)) as pilot:
                await pilot.press("3", "enter")
                await in_state(pilot, app, "running")
                await until(pilot, lambda: [view.holder for _, view in lab.devices()] == ["run pilot"])
                await pilot.press("m")
                await until(pilot, lambda: isinstance(app.screen, TextPrompt))
                await pilot.press(*"oil [red]", "enter")
                await pilot.press("p")
                await in_state(pilot, app, "paused")
                await pilot.press("m")
                await until(pilot, lambda: isinstance(app.screen, TextPrompt))
                await pilot.press("x", "escape")
                await pilot.press("r")
                await in_state(pilot, app, "running")
                await pilot.press("s")
                await in_state(pilot, app, "finished")
                await pilot.press("4")
                await until(pilot, lambda: app.query_one("#recordings-table", DataTable).row_count == 1)

    asyncio.run(drive())
    recording = only_recording(bench)
    assert recording.complete
    assert recording.metadata["end"]["exit_status"] == "0"
    told = kinds(recording, "run")
    marks = [event.body["message"] for event in recording.events if event.body.get("kind") == "mark"]
    assert marks == ["oil [red]"]
    assert [kind for kind in told if kind in ("paused", "stopping", "finished")] == [
        "paused",
        "stopping",
        "finished",
    ]
    assert "safe" in kinds(recording, "bench")
    assert registered_processes() == ()


@pytest.mark.extended
def test_the_emergency_stop_ends_the_run_and_holds_until_it_is_released(bench: Path) -> None:
    async def drive() -> None:
        with Session() as lab:
            app = LabApp(bench, lab)
            async with app.run_test(size=(100, 30)) as pilot:
                await pilot.press("3", "enter")
                await in_state(pilot, app, "running")
                await pilot.press("1", "f12")
                await in_state(pilot, app, "failed")
                await until(pilot, lambda: app.emergency.outcome is not None)
                assert read_latch() is not None
                await pilot.press("3", "enter")
                await pilot.pause(0.5)
                assert app.runner.state == "failed", "nothing starts while the stop stands"
                await pilot.press("f9")
                await until(pilot, lambda: isinstance(app.screen, Confirm))
                await pilot.press("y")
                await until(pilot, lambda: app.emergency.latch is None)
                assert read_latch() is None

    asyncio.run(drive())
    recording = only_recording(bench)
    assert recording.complete
    assert recording.metadata["end"]["exit_status"] == "1"


@pytest.mark.extended
def test_quitting_asks_while_a_run_is_on_and_ends_it_in_order(bench: Path) -> None:
    async def drive() -> None:
        with Session() as lab:
            app = LabApp(bench, lab)
            async with app.run_test(size=(80, 24)) as pilot:
                await pilot.press("3", "enter")
                await in_state(pilot, app, "running")
                await pilot.press("q")
                await until(pilot, lambda: isinstance(app.screen, Confirm))
                await pilot.press("n")
                await pilot.pause(0.2)
                assert app.runner.state == "running"
                await pilot.press("q")
                await until(pilot, lambda: isinstance(app.screen, Confirm))
                await pilot.press("y")
                await until(pilot, lambda: not app.runner.is_active)

    asyncio.run(drive())
    recording = only_recording(bench)
    assert recording.complete
    assert recording.metadata["end"]["reason"] == "the terminal UI is quit"


@pytest.mark.extended
@pytest.mark.parametrize(
    ("how", "status"),
    [(signal.SIGTERM, "0"), (signal.SIGHUP, "0"), (signal.SIGKILL, "1")],
    ids=["SIGTERM", "SIGHUP", "SIGKILL"],
)
def test_however_the_screen_ends_the_run_ends_too_and_a_crash_is_a_failure(
    bench: Path, how: signal.Signals, status: str
) -> None:
    ours, theirs = pty.openpty()
    command = [*PATIENT_LABHIL, "tui", "--folder", str(bench)]
    screen = subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, env={**os.environ, "TERM": "xterm-256color"}
    )
    os.close(theirs)
    drain = subprocess.Popen(["cat"], stdin=ours, stdout=subprocess.DEVNULL)
    try:
        wait(lambda: press_start(ours))
        wait(lambda: any(part.stat().st_size > MOVING for part in bench.glob("*.mcap.part")))
        screen.send_signal(how)
        screen.wait(PATIENCE)
        wait(lambda: any(bench.glob("*.mcap")))
        wait(lambda: registered_processes() == ())
    finally:
        screen.kill()
        screen.wait()
        os.close(ours)
        drain.kill()
        drain.wait()
    recording = only_recording(bench)
    assert recording.complete
    assert recording.metadata["end"]["exit_status"] == status
    assert "terminal UI" in recording.metadata["end"]["reason"]


def press_start(screen: int) -> bool:
    """Press the two keys, which a screen that is not up yet does not see; whether a run has come of it."""
    for key in (b"3", b"\r"):
        os.write(screen, key)
        time.sleep(1.0)
    return any(entry.kind == "run" for entry in registered_processes())


def wait(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.05)
