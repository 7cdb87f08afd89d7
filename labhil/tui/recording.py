"""The screen of one recording: every channel drawn, and its events."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static

from labhil.errors import LabhilError
from labhil.recording.contents import free_text_of
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording, StreamData
from labhil.report.formatting import format_count
from labhil.terminal import printable
from labhil.tui.background import work_in_background
from labhil.tui.curve import PlotCurve, column_curves, longest_gap
from labhil.tui.footer import KeyFooter
from labhil.tui.formatting import format_duration, format_frequency, outcome_label
from labhil.tui.plot import PLOT_HELP, Chart
from labhil.tui.recording_library import run_outcome
from labhil.tui.top_bar import WithBar

MOST_EVENTS = 40
ROUTINE = "status"


class RecordingScreen(WithBar):
    """Show the channels of a recording, which is read in a thread."""

    HELP = PLOT_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,backspace", "app.pop_screen", "Back", id="recording.back"),
    ]

    def __init__(self, path: Path) -> None:
        super().__init__(id="recording-screen")
        self._path = path

    def compose(self) -> ComposeResult:
        """Lay out a title, and room for charts."""
        yield Static(Text(f" {self._path.name} … reading", style="bold"), id="recording-title")
        yield VerticalScroll(id="recording-body")
        yield KeyFooter()

    def on_mount(self) -> None:
        """Start to read the recording."""
        work_in_background(self, self._read, f"reading {self._path.name}", "read")

    def _read(self) -> None:
        try:
            recording = read_recording(self._path)
        except LabhilError as error:
            self.app.call_later(self._fail, str(error))
            return
        self.app.call_later(partial(self._show, recording))

    def _fail(self, message: str) -> None:
        error = self.app.theme_variables["error"]
        self.query_one("#recording-title", Static).update(Text(f" ✕ {message}", style=f"bold {error}"))

    async def _show(self, recording: Recording) -> None:
        if not self.is_mounted:
            return
        colours = self.app.theme_variables
        status, reason = run_outcome(recording)
        title = Text(f" {self._path.name}  ", style="bold", no_wrap=True, overflow="ellipsis")
        title.append_text(outcome_label(status).text(colours))
        title.append(f"  {reason}", style=colours["muted"])
        self.query_one("#recording-title", Static).update(title)
        body = self.query_one("#recording-body")
        await body.mount(Static(_facts(recording), classes="recording-facts"))
        number = 0
        for data in recording.streams:
            for signal in data.stream.signals:
                if len(data) > 1:
                    chart = Chart(classes="recording-chart")
                    await body.mount(chart)
                    chart.show(*_channel(data, signal.name, number, colours))
                    number += 1
        await body.mount(Static(_events(recording, colours), classes="recording-events"))
        body.focus()


def _facts(recording: Recording) -> Text:
    text = Text()
    rig = recording.rig.kind.name if recording.rig is not None else "no rig file"
    text.append(f"{rig}, {format_duration(recording.duration)}")
    for data in recording.streams:
        text.append(f"\n/{data.device}/{data.stream.name}: {format_count(len(data))} samples")
        text.append(f" at {format_frequency(data.rate)}")
        text.append(f", {format_count(data.lost)} lost" if data.lost else ", none lost")
    for key, words in free_text_of(recording).items():
        text.append(f"\n{key}: {printable(words)}")
    for line in recording.warnings():
        text.append(f"\n▲ {line}")
    return text


def _channel(
    data: StreamData, name: str, number: int, colours: dict[str, str]
) -> tuple[Text, list[PlotCurve]]:
    signal = next(signal for signal in data.stream.signals if signal.name == name)
    values = data[name].reshape(len(data), -1)
    title = Text()
    title.append(name, style="bold")
    title.append(f", {signal.unit}  of /{data.device}/{data.stream.name}", style=colours["muted"])
    return title, column_curves(data.t, values, signal.width, number, longest_gap(data.t))


def _events(recording: Recording, colours: dict[str, str]) -> Text:
    events = [event for event in recording.events if event.topic != ROUTINE]
    text = Text("What happened\n", style="bold")
    for event in events[:MOST_EVENTS]:
        message = event.body.get("message") or event.body.get("text") or ""
        text.append(f"{event.t:9.3f} s  ".replace("-", "−"), style=colours["muted"])
        text.append(f"{event.device:<8} {event.body.get('kind', event.topic)}", style="not bold")
        text.append(f"  {message}\n", style="not bold")
    if len(events) > MOST_EVENTS:
        text.append(f"… and {len(events) - MOST_EVENTS} more\n", style="not bold")
    return text
