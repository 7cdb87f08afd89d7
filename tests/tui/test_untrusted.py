"""Whatever a device, a file or the bus says is shown as it is, and a screen outlives what comes and goes."""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from textual.widgets import DataTable, HelpPanel

from labhil.signals import Direction, Signal
from labhil.tui.app import LabApp
from labhil.tui.bus_watch import Announcement, DeviceView
from labhil.tui.live import LivePane
from labhil.tui.session import SignalSource
from labhil.tui.stream_watch import StreamWatch
from labhil.tui.ticks import axis_limits

sys.path.insert(0, str(Path(__file__).parent))

from still import ENDPOINT, NOW_NS, STATE, StillLab

HOSTILE = "[/nope] [red]x[/] [@click=app.quit]"


class HostileLab(StillLab):
    """The same devices, all of whose words are markup."""

    def devices(self) -> list[tuple[str, DeviceView]]:
        said = Announcement(NOW_NS, HOSTILE, HOSTILE, HOSTILE)
        stream = replace(STATE, signals=tuple(replace(s, description=HOSTILE) for s in STATE.signals))
        return [
            (endpoint, replace(
                view, name=view.name + HOSTILE, reason=HOSTILE, holder=HOSTILE, event=said,
                metadata={HOSTILE: HOSTILE}, stream=stream if view.stream else None,
            ))
            for endpoint, view in super().devices()
        ]  # fmt: skip

    def signal_sources(self) -> list[SignalSource]:
        signal = Signal("ball_position", "m", Direction.OUTPUT, description=HOSTILE)
        return [
            SignalSource(ENDPOINT, HOSTILE, "state", signal),
            SignalSource(ENDPOINT, "b[/]", "state", STATE.signals[1]),
        ]

    def events(self) -> list[Announcement]:
        return [Announcement(NOW_NS, HOSTILE, HOSTILE, HOSTILE)]


@pytest.mark.extended
def test_words_from_outside_are_no_markup_on_any_screen(folder: Path) -> None:
    fit = next(folder.glob("*.fit.json"))
    data = json.loads(fit.read_text(encoding="utf-8"))
    for row in data["parameters"]:
        row["name"] = row["key"] = HOSTILE
        row["unit"] = HOSTILE
    (folder / "a[red].fit.json").write_text(json.dumps(data), encoding="utf-8")
    (folder / "e[red].toml").write_text(f'[experiment]\nname = "{HOSTILE}"\n', encoding="utf-8")

    async def drive() -> None:
        lab = HostileLab()
        lab.fault = HOSTILE
        app = LabApp(folder, lab)  # type: ignore[arg-type]
        async with app.run_test(size=(120, 40)) as pilot:
            for key in "12345":
                await pilot.press(key)
                await pilot.pause(0.3)
            table = app.query_one("#results-table", DataTable)
            for row in range(table.row_count):
                table.move_cursor(row=row)
                await pilot.pause(0.2)
            app.notify(HOSTILE, title=HOSTILE)
            await pilot.press("ctrl+p")
            await pilot.pause(0.3)
        assert app.return_code in (None, 0)

    asyncio.run(drive())


class ComingAndGoing(StillLab):
    """A bus whose devices are there or not, under other endpoints each time."""

    def __init__(self) -> None:
        super().__init__()
        self.endpoint = ENDPOINT
        self.there = True

    def signal_sources(self) -> list[SignalSource]:
        if not self.there:
            return []
        return [SignalSource(self.endpoint, "bench", "state", signal) for signal in STATE.signals]

    def stream(self, place: SignalSource) -> StreamWatch | None:  # type: ignore[override]
        return super().stream(place) if place.endpoint == self.endpoint and self.there else None


@pytest.mark.extended
def test_signals_may_come_go_and_come_again_under_the_live_plots(folder: Path) -> None:
    async def drive() -> None:
        lab = ComingAndGoing()
        app = LabApp(folder, lab)  # type: ignore[arg-type]
        async with app.run_test(size=(100, 30)) as pilot:
            await pilot.press("2")
            for turn in range(6):
                lab.endpoint = f"tcp/127.0.0.1:{40123 + turn}"
                lab.there = turn % 3 != 2
                pane = app.query_one(LivePane)
                pane.refresh_view()
                pane.draw()  # before the list has become charts
                await pilot.pause(0.1)
                pane.draw()

    asyncio.run(drive())


@pytest.mark.extended
def test_a_frozen_picture_holds_when_its_device_goes(folder: Path) -> None:
    async def drive() -> None:
        lab = ComingAndGoing()
        app = LabApp(folder, lab)  # type: ignore[arg-type]
        async with app.run_test(size=(100, 30)) as pilot:
            await pilot.press("2")
            await pilot.pause(0.5)
            pane = app.query_one(LivePane)
            charts = len(pane.query(".live-chart"))
            assert charts > 0
            await pilot.press("z")
            lab.there = False
            await pilot.pause(0.8)
            assert len(pane.query(".live-chart")) == charts
            await pilot.press("z")
            await pilot.pause(0.8)
            assert len(pane.query(".live-chart")) == 0

    asyncio.run(drive())


@pytest.mark.extended
def test_the_key_that_opens_the_help_closes_it(folder: Path) -> None:
    async def drive() -> None:
        app = LabApp(folder, StillLab())  # type: ignore[arg-type]
        async with app.run_test(size=(100, 30)) as pilot:
            await pilot.press("question_mark")
            await pilot.pause()
            assert app.screen.query(HelpPanel)
            await pilot.press("question_mark")
            await pilot.pause()
            assert not app.screen.query(HelpPanel)

    asyncio.run(drive())


@pytest.mark.parametrize("value", [0.0, 5.0, -1e-7])
def test_a_constant_has_an_axis_as_wide_as_itself(value: float) -> None:
    low, high = axis_limits([np.full(10, value)])
    assert low < value < high
    assert high - low >= (abs(value) or 1.0)
