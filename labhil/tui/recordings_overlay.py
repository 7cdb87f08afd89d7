"""The screen of several recordings: their signals over each other, in time from their starts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from string import ascii_uppercase
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static

from labhil.errors import LabhilError
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording, StreamData
from labhil.tui.background import work_in_background
from labhil.tui.curve import PENS, Pen, PlotCurve, longest_gap
from labhil.tui.footer import KeyFooter
from labhil.tui.plot import PLOT_HELP, Chart
from labhil.tui.themes import CURVES
from labhil.tui.top_bar import WithBar

MOST_OVERLAID = 6
"""Recordings that differ in colour or pen."""


@dataclass(frozen=True, slots=True)
class OverlaidChannel:
    """Hold one column of a signal, of each recording that has it."""

    title: str
    curves: tuple[PlotCurve, ...]


class RecordingsOverlay(WithBar):
    """Show the signals of several recordings over each other; they are read in a thread."""

    HELP = PLOT_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,backspace", "app.pop_screen", "Back", id="recordings.back"),
    ]

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__(id="recording-screen")
        self._paths = tuple(paths)

    def compose(self) -> ComposeResult:
        """Lay out a title, and room for charts."""
        yield Static(self._title(" … reading"), id="recording-title")
        yield VerticalScroll(id="recording-body")
        yield KeyFooter()

    def on_mount(self) -> None:
        """Start to read the recordings."""
        work_in_background(self, self._read, "reading the recordings", "read")

    def _title(self, more: str = "") -> Text:
        return Text(f" {len(self._paths)} recordings{more}", style="bold", no_wrap=True, overflow="ellipsis")

    def _read(self) -> None:
        try:
            recordings = [read_recording(path) for path in self._paths]
        except LabhilError as error:
            self.app.call_later(self._fail, str(error))
            return
        self.app.call_later(partial(self._show, list(overlaid_channels(recordings))))

    def _fail(self, message: str) -> None:
        error = self.app.theme_variables["error"]
        self.query_one("#recording-title", Static).update(Text(f" ✕ {message}", style=f"bold {error}"))

    async def _show(self, channels: Sequence[OverlaidChannel]) -> None:
        if not self.is_mounted:
            return
        self.query_one("#recording-title", Static).update(self._title(", in time from their starts, s"))
        body = self.query_one("#recording-body")
        await body.mount(Static(self._legend(), classes="recording-facts"))
        for channel in channels:
            chart = Chart(classes="recording-chart")
            await body.mount(chart)
            chart.show(channel.title, channel.curves)
        body.focus()

    def _legend(self) -> Text:
        """A line for each recording, with its letter and its pen."""
        lines = []
        for number, path in enumerate(self._paths):
            colour, pen = _look(number)
            lines.append(
                Text.assemble(
                    (f"{pen.value} {ascii_uppercase[number]}", self.app.theme_variables[colour]),
                    f"  {path.name}",
                )
            )
        return Text("\n").join(lines)


def _look(number: int) -> tuple[str, Pen]:
    """Colour and pen of a recording: each differs from its neighbours in both."""
    return f"curve-{number % CURVES}", PENS[number % len(PENS)]


def overlaid_channels(recordings: Sequence[Recording]) -> Iterator[OverlaidChannel]:
    """Yield each column of each signal, with a curve for every recording that has it.

    Signals belong together by their names and those of their streams, and by those of their devices where a
    recording has several.
    """
    several = any(len({data.device for data in recording.streams}) > 1 for recording in recordings)
    found: dict[tuple[str, ...], tuple[str, list[PlotCurve]]] = {}
    for number, recording in enumerate(recordings):
        for data in recording.streams:
            place = f"/{data.device}/{data.stream.name}" if several else f"/{data.stream.name}"
            for name, unit, curve in _columns(data, number):
                title = f"{name}, {unit}  of {place}"
                found.setdefault((place, name), (title, []))[1].append(curve)
    for title, curves in found.values():
        yield OverlaidChannel(title, tuple(curves))


def _columns(data: StreamData, number: int) -> Iterator[tuple[str, str, PlotCurve]]:
    """Name, unit and curve of each column of a stream; nothing for less than two samples."""
    if len(data) < 2:
        return
    gap = longest_gap(data.t)
    colour, pen = _look(number)
    for signal in data.stream.signals:
        values = data[signal.name].reshape(len(data), -1)
        for i, column in enumerate(signal.columns()):
            yield (
                column,
                signal.unit,
                PlotCurve(data.t, values[:, i], colour, pen, ascii_uppercase[number], gap),
            )
