"""The bar at the top of every screen: the run, the field of the emergency stop, and who pressed it."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.events import Click
from textual.screen import Screen
from textual.widget import Widget
from textual.widgets import Static


@runtime_checkable
class BarSource(Protocol):
    """What the bar shows; the app has it."""

    def bar_line(self) -> Text:
        """Return the line about the run and the studies at work."""

    def stop_note(self) -> Text:
        """Return the red lines; empty while no emergency stop is in force."""


class StopButton(Static):
    """Press the emergency stop by a click."""

    def on_click(self, event: Click) -> None:
        """Stop everything."""
        event.stop()
        self.app.call_later(self.app.run_action, "app.stop_all")


class TopBar(Widget):
    """Show the run, the field that stops everything, and the emergency stop that is in force.

    Args:
        source: What is shown.
    """

    def __init__(self, source: BarSource) -> None:
        super().__init__()
        self._source = source
        self._line, self._note = Text(), Text()

    def compose(self) -> ComposeResult:
        """Lay out the bar, and the red lines under it."""
        with Horizontal(id="bar"):
            yield Static(" labhil ", id="brand")
            yield Static(id="bar-run")
            yield StopButton(" ■ STOP ALL  F12 ", id="bar-stop")
        yield Static(id="stop-note")

    def on_mount(self) -> None:
        """Show the present state."""
        self.refresh_view()

    def refresh_view(self) -> None:
        """Show what has changed."""
        if not self.is_mounted:
            return  # on_mount will do it
        line, note = self._source.bar_line(), self._source.stop_note()
        if line != self._line:
            self._line = line
            self.query_one("#bar-run", Static).update(line, layout=False)
        if note != self._note:
            self._note = note
            widget = self.query_one("#stop-note", Static)
            widget.display = bool(note.plain)
            widget.update(note)


class WithBar(Screen[Any]):
    """Put the bar on a screen, above and before all else.

    Every screen and dialog has this base, as its last one: Textual looks for styles along the first.
    """

    async def mount_composed_widgets(self, widgets: list[Widget]) -> None:
        """Mount the widgets of the screen, and the bar."""
        bar: list[Widget] = [TopBar(self.app)] if isinstance(self.app, BarSource) else []
        await super().mount_composed_widgets([*bar, *widgets])
