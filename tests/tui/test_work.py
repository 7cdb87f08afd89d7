"""The screen at work on files, and on a bus that nobody told it of: export, verification, --connect."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL
from textual.pilot import Pilot
from textual.widgets import DataTable, OptionList, Static

from labhil.bus.register import registered_processes
from labhil.recording.reader import read_recording
from labhil.tui.app import LabApp
from labhil.tui.dialogs import Choose, Notice
from labhil.tui.overlay import ModelsScreen, OverlayScreen
from labhil.tui.plot import Plot
from labhil.tui.session import Session

PATIENCE = 100.0
LABHIL = PATIENT_LABHIL
LAB = """
[lab]
record = false
analyse = []
[devices.far]
plugin = "ball_beam"
address = "twin"
"""

pytestmark = [pytest.mark.timeout(300), pytest.mark.extended]

Drive = Callable[[Pilot[None], LabApp], Awaitable[None]]


def work(folder: Path, drive: Drive, connect: tuple[str, ...] = (), size: tuple[int, int] = (80, 24)) -> None:
    async def go() -> None:
        with Session(connect) as lab:
            app = LabApp(folder, lab)
            async with app.run_test(size=size) as pilot:
                await drive(pilot, app)

    asyncio.run(go())


async def until(pilot: Pilot[None], condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        await pilot.pause(0.05)


async def recordings(pilot: Pilot[None], app: LabApp) -> None:
    await pilot.press("4")
    await until(pilot, lambda: app.query_one("#recordings-table", DataTable).row_count == 2)


def test_terms_are_switched_over_the_measurement(folder: Path) -> None:
    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        await pilot.press("5")
        await until(pilot, lambda: app.query_one("#results-table", DataTable).row_count == 2)
        await pilot.press("down", "o")
        screen = app.screen
        assert isinstance(screen, OverlayScreen)
        await until(pilot, lambda: screen.shown == frozenset())
        errors = screen.query_one("#overlay-errors", Static)
        whole = str(errors.content)
        assert whole.startswith("ball_position: RMSE 0.000")
        await pilot.press("n")
        await until(pilot, lambda: screen.shown is not None and len(screen.shown) == 7)
        assert str(errors.content).endswith(f", all terms {whole.removeprefix('ball_position: RMSE ')}")
        assert str(errors.content) != whole
        await pilot.press("i")
        await until(pilot, lambda: screen.shown == frozenset())
        assert str(errors.content) == whole
        await pilot.press("escape")
        assert app.screen is not screen

    work(folder, drive)


def test_marked_models_are_switched_over_one_recording(folder: Path) -> None:
    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        await pilot.press("5")
        await until(pilot, lambda: app.query_one("#results-table", DataTable).row_count == 2)
        await pilot.press("space", "down", "space", "o")
        screen = app.screen
        assert isinstance(screen, ModelsScreen)
        await until(pilot, lambda: screen.shown == {"A", "B"})
        legend = screen.query_one(".chart-title", Static)
        errors = str(screen.query_one("#overlay-errors", Static).content)
        assert re.fullmatch(r"ball_position: RMSE A 0\.000\d+ m, B 0\.000\d+ m", errors), errors
        assert re.findall(r"measured|[AB]", str(legend.content)) == ["measured", "A", "B"]
        await pilot.press("space")
        await until(pilot, lambda: screen.shown == {"B"})
        assert re.findall(r"measured|[AB]", str(legend.content)) == ["measured", "B"]
        await pilot.press("u")
        await until(pilot, lambda: str(legend.content).startswith("ball_position, less measured, m"))
        low, high = screen.query_one(Plot).view[1]
        assert -0.005 < low < 0.0 < high < 0.005
        assert "2 models over ball_beam_test.mcap" in str(screen.query_one("#overlay-title", Static).content)
        await pilot.press("escape")
        assert app.screen is not screen

    work(folder, drive)


def test_a_result_without_its_recording_says_what_is_missing(folder: Path) -> None:
    (folder / "ball_beam_test.mcap").unlink()

    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        await pilot.press("5")
        await until(pilot, lambda: app.query_one("#results-table", DataTable).row_count == 2)
        await pilot.press("o")
        title = app.screen.query_one("#overlay-title", Static)
        await until(pilot, lambda: "expected its recording ball_beam_test.mcap" in str(title.content))

    work(folder, drive)


@pytest.mark.parametrize("size", [(80, 24), (160, 50)])
def test_x_writes_the_samples_as_csv_and_says_so(folder: Path, size: tuple[int, int]) -> None:
    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        await recordings(pilot, app)
        await pilot.press("x")
        await until(pilot, lambda: bool(app.studies.jobs.all) and app.studies.jobs.all[0].state != "at work")
        assert app.studies.jobs.all[0].state == "done", app.studies.jobs.all[0].message
        assert [note.title for note in app._notifications if note.message == "done"]

    work(folder, drive, size=size)
    written = folder / "ball_beam_identify.csv"
    data = read_recording(folder / "ball_beam_identify.mcap").stream_with("ball_position")
    assert written.read_text().startswith("t,ball_position,")
    table = np.loadtxt(written, delimiter=",", skiprows=1)
    assert np.array_equal(table[:, 0], data.t)
    assert np.array_equal(table[:, 1], data["ball_position"])


def test_an_export_that_fails_is_told_and_leaves_nothing(folder: Path) -> None:
    (folder / "ball_beam_identify.csv").write_text("precious")
    before = sorted(folder.iterdir())

    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        await recordings(pilot, app)
        (folder / "ball_beam_identify.mcap").unlink()
        await pilot.press("x")
        await until(pilot, lambda: bool(app.studies.jobs.all) and app.studies.jobs.all[0].state == "failed")
        assert "ball_beam_identify.mcap" in app.studies.jobs.all[0].message

    work(folder, drive)
    left = [path for path in before if path.name != "ball_beam_identify.mcap"]
    assert sorted(folder.iterdir()) == left


@pytest.mark.parametrize("size", [(80, 24), (160, 50)])
def test_v_holds_a_recording_against_a_result_of_the_folder(folder: Path, size: tuple[int, int]) -> None:
    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        await recordings(pilot, app)
        await pilot.press("v")
        await until(pilot, lambda: isinstance(app.screen, Choose))
        shown = app.screen.query_one(OptionList)
        names = [str(shown.get_option_at_index(i).prompt) for i in range(shown.option_count)]
        assert names == ["ball_beam_identify.diagnosis.json", "ball_beam_identify.fit.json"]
        await pilot.press("down", "enter")

        def told_so_far() -> str:
            return "\n".join(str(static.render()) for static in app.screen.query(Static))

        # a screen is there before what it shows
        await until(pilot, lambda: isinstance(app.screen, Notice) and bool(told_so_far()))
        told = told_so_far()
        assert "verify ball_beam_identify" in told
        assert "p = " in told or "p-value" in told, told
        await pilot.press("escape")
        assert app.studies.jobs.all[0].state == "done"

    work(folder, drive, size=size)


def test_v_without_any_result_says_what_to_do(folder: Path) -> None:
    for path in folder.glob("*.json"):
        path.unlink()

    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        await recordings(pilot, app)
        await pilot.press("v")
        await until(pilot, lambda: len(app._notifications) > 0)
        assert next(note.message for note in app._notifications).startswith("There is no fit or diagnosis")
        assert app.studies.jobs.all == []

    work(folder, drive)


def test_connect_shows_a_bus_that_does_not_announce_itself_and_stops_its_devices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A service of another user, as it were: its notes are where this screen cannot see them."""
    (tmp_path / "lab.toml").write_text(LAB)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    service = subprocess.Popen(
        [*LABHIL, "serve", "--config", "lab.toml"],
        cwd=tmp_path,
        env={**os.environ, "XDG_RUNTIME_DIR": str(elsewhere)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert service.stdout is not None
    try:
        endpoint = service.stdout.readline().strip()
        assert registered_processes() == ()

        async def drive(pilot: Pilot[None], app: LabApp) -> None:
            await until(pilot, lambda: [view.name for _, view in app.session.devices()] == ["far"])
            await until(pilot, lambda: app.session.devices()[0][1].health is not None)
            await pilot.press("2")
            await until(pilot, lambda: len(app.session.signal_sources()) > 0)
            await pilot.press("f12")
            await until(
                pilot, lambda: app.emergency.outcome is not None and "far" in app.emergency.outcome.answered
            )
            await until(pilot, lambda: app.session.devices()[0][1].state == "latched")
            await pilot.press("f9", "y")
            await until(pilot, lambda: app.emergency.latch is None)

        work(tmp_path, drive, (endpoint,))
    finally:
        service.send_signal(signal.SIGINT)
        service.wait(PATIENCE)
        service.stdout.close()


@pytest.mark.parametrize(
    ("endpoint", "told"),
    [("tcp/127.0.0.1:1", "tcp/127.0.0.1:1"), ("nonsense", "nonsense")],
)
def test_connect_to_nobody_is_told_before_the_screen_is_drawn(
    tmp_path: Path, endpoint: str, told: str
) -> None:
    done = subprocess.run(
        [*LABHIL, "tui", "--folder", str(tmp_path), "--connect", endpoint],
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode in (1, 2)
    assert told in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
