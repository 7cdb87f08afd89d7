"""States and quantities as text: each state has a sign and a word, so that colour is never needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from labhil.report.formatting import NOTHING
from labhil.tui.bus_watch import DeviceView


@dataclass(frozen=True, slots=True)
class StateLabel:
    """Label a state by a sign, a word, and a colour of the theme."""

    sign: str
    word: str
    colour: str

    def text(self, colours: dict[str, str]) -> Text:
        """Return the label in the colours of a theme."""
        return Text(f"{self.sign} {self.word}", style=f"bold {colours.get(self.colour, 'default')}")


STATES = {
    "active": StateLabel("▶", "active", "success"),
    "idle": StateLabel("○", "idle", "foreground"),
    "connecting": StateLabel("…", "connecting", "muted"),
    "tripped": StateLabel("▲", "TRIPPED", "error"),
    "latched": StateLabel("■", "LATCHED", "error"),
    "reconnecting": StateLabel("…", "reconnecting", "warning"),
    "failed": StateLabel("✕", "FAILED", "error"),
    "stopped": StateLabel("■", "stopped", "muted"),
    "no answer": StateLabel("?", "no answer", "warning"),
    "gone": StateLabel("✕", "gone", "muted"),
    "replay": StateLabel("↻", "replay", "accent"),
    "replay paused": StateLabel("‖", "replay", "accent"),
    "replay ended": StateLabel("■", "replay", "muted"),
}

RUN_STATES = {
    "idle": StateLabel("○", "nothing runs", "muted"),
    "starting": StateLabel("…", "starting", "accent"),
    "running": StateLabel("▶", "RUNNING", "success"),
    "paused": StateLabel("‖", "PAUSED", "warning"),
    "stopping": StateLabel("■", "stopping", "accent"),
    "aborting": StateLabel("■", "aborting", "error"),
    "finished": StateLabel("✓", "finished", "success"),
    "failed": StateLabel("✕", "failed", "error"),
}

OUTCOMES = {
    "done": StateLabel("✓", "done", "success"),
    "imported": StateLabel("⇣", "imported", "foreground"),
    "growing": StateLabel("●", "growing", "accent"),
    "no end": StateLabel("▲", "no end", "warning"),
    "unreadable": StateLabel("✕", "unreadable", "error"),
}


class PlainTable(Table):
    """Show cells without interpreting markup: they hold names of devices, files and signals."""

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Add a row of plain texts."""
        super().add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells), **options)


def plain_grid() -> PlainTable:
    """Make a table without frame and headings."""
    return PlainTable(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))


def device_label(view: DeviceView) -> StateLabel:
    """Return the label of a device; a live device that sends nothing is silent, whatever its state."""
    if view.state == "gone":
        return STATES["gone"]
    if view.health is not None and view.health.silent and not view.is_replayed:
        return StateLabel("◌", f"SILENT {format_seconds(view.health.age)}", "warning")
    return STATES.get(view.state, StateLabel("?", view.state, "muted"))


def outcome_label(status: str) -> StateLabel:
    """Return the label of the outcome of a recording."""
    return OUTCOMES.get(status, StateLabel("✕", status, "error"))


def format_duration(seconds: float | None) -> str:
    """Format a duration: ``12.3 s``, ``2 min 05 s``."""
    if seconds is None:
        return NOTHING
    if seconds < 100:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def format_seconds(seconds: float) -> str:
    """Format a duration in whole seconds, ``3 s``; longer ones in minutes."""
    return f"{seconds:.0f} s" if seconds < 100 else format_duration(seconds)


def format_milliseconds(seconds: float | None) -> str:
    """Format a duration in milliseconds: ``0.4 ms``."""
    if seconds is None:
        return NOTHING
    return f"{1e3 * seconds:.1f} ms" if abs(seconds) < 0.9995 else f"{seconds:.1f} s"


def format_frequency(rate: float | None) -> str:
    """Format a frequency: ``99.8 Hz``."""
    return NOTHING if rate is None else f"{rate:.4g} Hz"


def format_size(number: int) -> str:
    """Format a number of bytes: ``1.2 MB``."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if number >= factor:
            return f"{number / factor:.3g} {unit}"
    return f"{number} B"
