"""Measurement and model over each other, with each term of the model switched on and off."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Vertical, VerticalScroll
from textual.content import Content
from textual.message import Message
from textual.screen import Screen
from textual.widgets import Footer, SelectionList, Static
from textual.widgets.selection_list import Selection

from labhil.campaign.studies.overlay import MODULE
from labhil.campaign.studies.process import Helper
from labhil.tui.curve import Curve, Pen
from labhil.tui.plot import Chart

Channel = dict[str, Any]


@dataclass
class Simulated(Message):
    """A line of the process that simulates."""

    line: dict[str, Any]


class OverlayScreen(Screen[None]):
    """The outputs of a recording under the whole model and under the terms that are switched on."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,backspace", "app.pop_screen", "Back", id="overlay.back"),
        Binding("a", "all", "All on", id="overlay.all", tooltip="Switch all terms on"),
        Binding("n", "none", "All off", id="overlay.none", tooltip="Switch all terms off", show=False),
        Binding("f12", "app.stop_all", "STOP ALL", id="overlay.stop", tooltip="Emergency stop"),
    ]

    def __init__(self, path: Path) -> None:
        super().__init__(id="overlay-screen")
        self._path = path
        self._helper: Helper | None = None
        self._whole: list[Channel] = []
        self._charts: list[Chart] = []
        self._reason = ""
        self.shown: frozenset[str] | None = None
        """The terms without which the model on the screen was simulated; None before the first."""

    def compose(self) -> ComposeResult:
        """A title, the terms, what the errors are, and room for charts."""
        yield Static(Text(f" {self._path.name} … simulating", style="bold"), id="overlay-title")
        with Container(id="overlay-split"):
            with Vertical(id="overlay-side"):
                yield SelectionList[str](id="overlay-terms")
                yield Static(id="overlay-errors")
            yield VerticalScroll(id="overlay-charts", can_focus=False)
        yield Footer(show_command_palette=False)

    def on_mount(self) -> None:
        """Have the model simulated."""
        told = {"result": str(self._path.absolute())}
        self._helper = Helper("the simulation", MODULE, told, self._hear)

    def _hear(self, line: dict[str, Any]) -> None:
        self.post_message(Simulated(line))

    def on_unmount(self) -> None:
        """Nobody needs it any more."""
        if self._helper is not None:
            self._helper.close(0.2)

    async def on_simulated(self, message: Simulated) -> None:
        """The curves, or why there are none."""
        message.stop()
        line = message.line
        if "failed" in line:
            self._reason = str(line["failed"])
            self._fail(self._reason)
        elif "ended" in line:
            self._fail(self._reason or str(line["complaint"] or "the process that simulates has ended"))
        elif "terms" in line:
            self._whole = line["channels"]
            await self._begin(line)
        if "channels" in line:
            self._draw(line)

    def _fail(self, reason: str) -> None:
        title = Text(f" ✕ {reason}", style=f"bold {self.app.theme_variables['error']}")
        self.query_one("#overlay-title", Static).update(title)

    async def _begin(self, line: dict[str, Any]) -> None:
        listed = self.query_one(SelectionList)
        for term in line["terms"]:
            listed.add_option(Selection(Content(term), term, True))
        self._charts = [Chart(classes="overlay-chart") for _ in line["channels"]]
        await self.query_one("#overlay-charts").mount_all(self._charts)
        listed.highlighted = 0
        listed.focus()

    def _draw(self, line: dict[str, Any]) -> None:
        self.shown = frozenset(line["without"])
        for chart, whole, channel in zip(self._charts, self._whole, line["channels"], strict=True):
            chart.show(f"{channel['name']}, {channel['unit']}", curves_of(whole, channel), keep_view=True)
        errors = [_errors(*pair) for pair in zip(self._whole, line["channels"], strict=True)]
        self.query_one("#overlay-errors", Static).update(Text("\n".join(errors)))
        self._tell()

    def _tell(self) -> None:
        """Say what is on the screen, and whether it is what is chosen."""
        if self.shown is None:
            return
        waits = "" if self.shown == self._without() else " … simulating"
        title = Text(f" {self._path.name}{waits}", style="bold", no_wrap=True, overflow="ellipsis")
        self.query_one("#overlay-title", Static).update(title)

    def _without(self) -> frozenset[str]:
        listed = self.query_one(SelectionList)
        every = [listed.get_option_at_index(i).value for i in range(listed.option_count)]
        return frozenset(every) - frozenset(listed.selected)

    def on_selection_list_selected_changed(self, _event: Any) -> None:
        """Simulate with these terms."""
        if self.shown is not None and self._helper is not None:
            self._helper.tell({"without": sorted(self._without())})
            self._tell()

    def action_all(self) -> None:
        """Switch all terms on."""
        self.query_one(SelectionList).select_all()

    def action_none(self) -> None:
        """Switch all terms off."""
        self.query_one(SelectionList).deselect_all()


def curves_of(whole: Channel, chosen: Channel) -> list[Curve]:
    """Return the curves of an output: measured, under all terms, and under those that are chosen."""
    t = np.array(whole["t"])
    measured = Curve(t, _numbers(whole["measured"]), "curve-measured", Pen.DOTS, "measured")
    model = Curve(t, _numbers(chosen["simulated"]), "curve-0", Pen.SOLID, "model")
    if not chosen["without"]:
        return [measured, model]
    complete = Curve(t, _numbers(whole["simulated"]), "curve-1", Pen.DASHED, "all terms")
    return [measured, complete, model]


def _errors(whole: Channel, chosen: Channel) -> str:
    """The RMSE of an output, and what it is under all terms."""
    text = f"{chosen['name']}: RMSE {_error(chosen)}"
    return f"{text}, all terms {_error(whole)}" if chosen["without"] else text


def _error(channel: Channel) -> str:
    return "unknown" if channel["rmse"] is None else f"{channel['rmse']:.3g} {channel['unit']}"


def _numbers(values: list[float | None]) -> Any:
    return np.array([np.nan if value is None else value for value in values])
