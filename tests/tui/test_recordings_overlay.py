"""Marked recordings over each other: one chart for each signal, whose curves differ in colour and pen."""

from __future__ import annotations

import asyncio
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from textual.pilot import Pilot
from textual.widgets import Static

from labhil.recording.reader import read_recording
from labhil.tui.app import LabApp
from labhil.tui.recordings import RecordingsPane
from labhil.tui.recordings_overlay import RecordingsOverlay, overlaid_channels

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

SETTLED = 0.15
SIGNALS = ["ball_position", "servo_angle", "servo_angle_requested", "servo_angle_applied"]


async def press(pilot: Pilot[None], *keys: str) -> None:
    for key in keys:
        await pilot.app.workers.wait_for_complete()
        await pilot.pause(SETTLED)
        await pilot.press(key)
    await pilot.app.workers.wait_for_complete()
    await pilot.pause(2 * SETTLED)


def test_two_marked_recordings_are_drawn_over_each_other(folder: Path) -> None:
    async def go() -> tuple[str, list[str]]:
        app = LabApp(folder, StillLab(), tab="recordings")  # type: ignore[arg-type]
        async with app.run_test(size=(100, 50)) as pilot:
            await press(pilot, "home", "o")
            assert len(app.screen_stack) == 1, "one recording has nothing to be laid over"
            await press(pilot, "space", "down", "space", "o")
            screen = app.screen
            assert isinstance(screen, RecordingsOverlay)
            legend = str(screen.query_one(".recording-facts", Static).content)
            return legend, [str(title.content) for title in screen.query(".chart-title").results(Static)]

    legend, titles = asyncio.run(go())
    assert legend.splitlines() == ["━━ A  ball_beam_identify.mcap", "╍╍ B  ball_beam_test.mcap"]
    assert [title.partition(",")[0] for title in titles] == SIGNALS
    assert all(title.endswith("━━ A   ╍╍ B") for title in titles)


def test_recordings_of_different_rigs_are_not_mixed(folder: Path) -> None:
    async def go() -> list[str]:
        app = LabApp(folder, StillLab(), tab="recordings")  # type: ignore[arg-type]
        async with app.run_test(size=(100, 50)) as pilot:
            await press(pilot, "home", "space", "down", "space")
            pane = app.query_one(RecordingsPane)
            first, second = pane._entries
            pane.show_entries([first, replace(second, rig="dc_motor")])
            await pilot.press("o")
            await pilot.pause(SETTLED)
            assert len(app.screen_stack) == 1
            return [note.message for note in app._notifications]

    assert asyncio.run(go()) == ["Only recordings of one rig are drawn over each other."]


def test_a_curve_holds_the_samples_of_its_recording(folder: Path) -> None:
    recordings = [read_recording(path) for path in sorted(folder.glob("*.mcap"))]
    channels = list(overlaid_channels(recordings))
    assert [channel.title.partition(",")[0] for channel in channels] == SIGNALS
    for recording, curve in zip(recordings, channels[0].curves, strict=True):
        data = recording.streams[0]
        np.testing.assert_array_equal(curve.x, data.t)
        np.testing.assert_array_equal(curve.y, data["ball_position"])


def test_a_recording_that_has_gone_says_so(folder: Path) -> None:
    async def go() -> str:
        app = LabApp(folder, StillLab(), tab="recordings")  # type: ignore[arg-type]
        async with app.run_test(size=(100, 50)) as pilot:
            await press(pilot, "home", "space", "down", "space")
            shutil.move(folder / "ball_beam_test.mcap", folder / "moved")
            await pilot.press("o")
            await pilot.pause(SETTLED)
            await app.workers.wait_for_complete()
            await pilot.pause(2 * SETTLED)
            return str(app.screen.query_one("#recording-title", Static).content)

    title = asyncio.run(go())
    assert title.startswith(" ✕ ")
    assert "ball_beam_test.mcap" in title
