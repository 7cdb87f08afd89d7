"""Threads of the terminal UI, of its processes and of a replay that die: somebody says so, none hangs."""

from __future__ import annotations

import asyncio
import io
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from textual.app import App

from labhil.bus.session import open_bus
from labhil.campaign.studies.process import Helper, read_further_lines
from labhil.recording.reader import read_recording
from labhil.service.replay import Replay
from labhil.tui import shutdown
from labhil.tui.app import LabApp
from labhil.tui.background import OUT_OF_DATE, work_in_background
from labhil.tui.bus_watch import BusWatch
from labhil.tui.emergency_stop import EmergencyStop
from labhil.tui.session import Session

PATIENCE = 60.0
FILE = Path(__file__).parents[2] / "recordings" / "ball_beam_identify.mcap"


def dies(*_: object) -> None:
    raise SystemExit("struck")


def wait_until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.01)


def test_a_replay_says_what_ended_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Replay, "_step", dies)
    with Replay(read_recording(FILE)) as replay:
        assert replay.wait(PATIENCE)
        assert "'replay' has died: SystemExit('struck')" in replay.fault


def test_a_process_that_is_not_heard_is_ended(tmp_path: Path) -> None:
    """As the screen is, whose run goes on: it ends in order, and is not shown as if it were on."""
    lines: list[dict[str, Any]] = []

    def hear(line: dict[str, Any]) -> None:
        lines.append(line)
        if "ended" not in line:
            dies()

    request = {"experiment": str(tmp_path / "not there.toml"), "out": str(tmp_path)}
    helper = Helper("the run", "labhil.tui.run_process", request, hear)
    try:
        wait_until(lambda: not helper.running)
        assert lines[-1]["ended"] is None
        assert "SystemExit('struck')" in lines[-1]["complaint"]
    finally:
        helper.close()


def test_a_process_that_hears_nothing_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO('{"do": "pause"}\n'))
    monkeypatch.setattr(threading, "excepthook", lambda _: None)
    ended = threading.Event()
    read_further_lines(dies, ended.set)
    assert ended.wait(PATIENCE)


@pytest.mark.parametrize(("owner", "method"), [(Session, "_discover"), (BusWatch, "_poll_once")])
def test_a_view_that_is_out_of_date_says_so(
    owner: type, method: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    async def look(bus_at: str) -> None:
        lab = Session([bus_at], discover=dies if owner is Session else list)
        with lab:
            app = LabApp(tmp_path, lab)
            async with app.run_test() as pilot:
                deadline = time.monotonic() + PATIENCE
                while not any(OUT_OF_DATE in note.message for note in app._notifications):
                    assert time.monotonic() < deadline, "nothing is shown"
                    await pilot.pause(0.05)
            assert "SystemExit('struck')" in lab.failure()
            assert "SystemExit('struck')" in lab.fault

    if owner is BusWatch:
        monkeypatch.setattr(BusWatch, method, dies)
    with open_bus() as bus:
        asyncio.run(look(bus.endpoint))


def test_work_in_the_background_that_raises_is_shown() -> None:
    async def work() -> list[str]:
        app = App[None]()
        async with app.run_test() as pilot:
            worker = work_in_background(app, dies, "reading", "read")
            await worker.wait()
            await pilot.pause()
            return [note.message for note in app._notifications]

    assert asyncio.run(work()) == ["reading failed: SystemExit('struck')"]


def test_an_emergency_stop_that_fails_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Session, "stop_all", dies)
    logged: list[str] = []

    async def press() -> list[str]:
        app = App[None]()
        async with app.run_test() as pilot:
            stop = EmergencyStop(app, Session(), lambda: True, lambda *line: logged.append(": ".join(line)))
            stop.press()
            deadline = time.monotonic() + PATIENCE
            while not (logged and app._notifications):
                assert time.monotonic() < deadline, "nobody says so"
                await pilot.pause(0.05)
            return [note.message for note in app._notifications]

    assert asyncio.run(press()) == ["the emergency stop failed: SystemExit('struck')"]
    (line,) = logged
    assert line.startswith("stop all: did not stop properly: the stop itself failed: SystemExit('struck')")


def test_a_page_ends_where_its_server_is_watched_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutdown, "_end_with", dies)
    monkeypatch.setenv(shutdown.SERVER, "1")
    requested: list[str] = []

    class Page(App[None]):
        @property
        def is_web(self) -> bool:
            return True

    async def show() -> int | None:
        app = Page()
        async with app.run_test() as pilot:
            runner = SimpleNamespace(request=lambda what, reason="": requested.append(f"{what}: {reason}"))
            shutdown.end_in_order(app, runner)
            deadline = time.monotonic() + PATIENCE
            while not requested:
                assert time.monotonic() < deadline, "the page goes on"
                await pilot.pause(0.05)
        return app.return_code

    assert asyncio.run(show()) == 129
    assert requested == ["stop: the terminal UI was ended by SIGHUP"]
