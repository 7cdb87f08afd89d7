"""Models over a measurement: the terms of one model, or several models, switched on and off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import ascii_uppercase
from typing import Any, ClassVar

import numpy as np
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Vertical, VerticalScroll
from textual.content import Content
from textual.message import Message
from textual.widgets import SelectionList, Static
from textual.widgets.selection_list import Selection

from labhil.campaign.studies.overlay import MODULE
from labhil.campaign.studies.process import Helper
from labhil.signals import FloatArray
from labhil.tui.curve import Pen, PlotCurve
from labhil.tui.footer import KeyFooter
from labhil.tui.lists import LabSelection
from labhil.tui.plot import PLOT_HELP, Chart, Plot
from labhil.tui.themes import CURVES
from labhil.tui.top_bar import WithBar

Channel = dict[str, Any]


@dataclass
class SimulationLine(Message):
    """Carry a line of the process that simulates."""

    line: dict[str, Any]


class Overlay(WithBar):
    """Show outputs of a recording, with models over them that a list switches on and off.

    Args:
        heading: Title of the screen.
        request: Request to the process that simulates.
    """

    HELP = PLOT_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,backspace", "app.pop_screen", "Back", id="overlay.back"),
        Binding("i", "all", "All on", id="overlay.all", tooltip="Switch all on"),
        Binding("n", "none", "All off", id="overlay.none", tooltip="Switch all off", show=False),
    ]

    def __init__(self, heading: str, request: Mapping[str, Any]) -> None:
        super().__init__(id="overlay-screen")
        self._heading, self._request = heading, request
        self._helper: Helper | None = None
        self._charts: list[Chart] = []
        self._reason = ""

    def compose(self) -> ComposeResult:
        """Lay out the title, the list, the errors and the charts."""
        yield Static(Text(f" {self._heading} … simulating", style="bold"), id="overlay-title")
        with Container(id="overlay-split"):
            with Vertical(id="overlay-side"):
                yield LabSelection(id="overlay-terms")
                yield Static(id="overlay-errors")
            yield VerticalScroll(id="overlay-charts", can_focus=False)
        yield KeyFooter()

    def on_mount(self) -> None:
        """Start to simulate the models."""
        self._helper = Helper("the simulation", MODULE, self._request, self._forward_line)

    def _forward_line(self, line: dict[str, Any]) -> None:
        self.post_message(SimulationLine(line))

    def on_unmount(self) -> None:
        """End the process that simulates."""
        if self._helper is not None:
            self._helper.close(0.2)

    async def on_simulation_line(self, message: SimulationLine) -> None:
        """Show the curves, or why there are none."""
        message.stop()
        line = message.line
        if "failed" in line:
            self._reason = str(line["failed"])
            self._fail(self._reason)
        elif "ended" in line:
            if line["ended"] != 0 or not self._charts:
                self._fail(self._reason or str(line["complaint"] or "the process that simulates has ended"))
        elif "channels" in line:
            await self.show_line(line)

    async def show_line(self, line: dict[str, Any]) -> None:
        """Show a line of the process that has curves."""
        raise NotImplementedError

    def _fail(self, reason: str) -> None:
        title = Text(f" ✕ {reason}", style=f"bold {self.app.theme_variables['error']}")
        self.query_one("#overlay-title", Static).update(title)

    async def add_options(self, options: Mapping[str, str], charts: int) -> None:
        """List the options, and mount the charts.

        Args:
            options: Names of the options by their keys.
            charts: Number of charts.
        """
        selection_list = self.query_one(SelectionList)
        for value, name in options.items():
            selection_list.add_option(Selection(Content(name), value, True))
        self._charts = [Chart(classes="overlay-chart") for _ in range(charts)]
        await self.query_one("#overlay-charts").mount_all(self._charts)
        selection_list.highlighted = 0
        selection_list.focus()

    def show_errors(self, lines: Sequence[str]) -> None:
        """Show the sizes of the errors."""
        self.query_one("#overlay-errors", Static).update(Text("\n".join(lines)))

    def show_title(self, more: str = "") -> None:
        """Show the heading, with more after it."""
        title = Text(f" {self._heading}{more}", style="bold", no_wrap=True, overflow="ellipsis")
        self.query_one("#overlay-title", Static).update(title)

    def action_all(self) -> None:
        """Switch all on."""
        self.query_one(SelectionList).select_all()

    def action_none(self) -> None:
        """Switch all off."""
        self.query_one(SelectionList).deselect_all()


class ModelsScreen(Overlay):
    """Show the outputs of a recording with the models of several results, or the errors of each model."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "u",
            "differences",
            "Errors",
            id="overlay.differences",
            tooltip="Each model less the measurement, or both over each other again",
        ),
    ]

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__(
            f"{len(paths)} models over one recording", {"results": [str(path.absolute()) for path in paths]}
        )
        self._line: dict[str, Any] | None = None
        self._differences = False
        self.shown: frozenset[str] | None = None
        """The letters of the models on the screen; None before the first."""

    async def show_line(self, line: dict[str, Any]) -> None:
        """Show all models."""
        self._heading = f"{len(line['models'])} models over {line['recording']}"
        options = {
            letter: f"{letter}  {name}" for letter, name in zip(ascii_uppercase, line["models"], strict=False)
        }
        await self.add_options(options, len(line["channels"]))
        self._line = line
        self._draw()

    def on_selection_list_selected_changed(self, _event: Any) -> None:
        """Draw the selected models."""
        self._draw()

    def _draw(self) -> None:
        if self._line is None:
            return
        selected, errors = set(self.query_one(SelectionList).selected), list[str]()
        for chart, channel in zip(self._charts, self._line["channels"], strict=True):
            models = [(ascii_uppercase[m["number"]], m) for m in channel["models"]]
            curves = [] if self._differences else [_measured_curve(channel)]
            for letter, model in models:
                if letter in selected:
                    colour = f"curve-{model['number'] % CURVES}"
                    curves.append(PlotCurve(*self._model_curve(channel, model), colour, Pen.SOLID, letter))
            what = "less measured, " if self._differences else ""
            chart.show(f"{channel['name']}, {what}{channel['unit']}", curves, keep_view=True)
            rmse = [f"{letter} {_error({**model, 'unit': channel['unit']})}" for letter, model in models]
            errors.append(f"{channel['name']}: RMSE {', '.join(rmse)}")
        self.shown = frozenset(selected)
        self.show_errors(errors)
        self.show_title()

    def _model_curve(self, channel: Channel, model: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
        """Times and values of a model's curve."""
        t, simulated = np.array(model["t"]), _numbers(model["simulated"])
        if not self._differences:
            return t, simulated
        return t, simulated - np.interp(t, np.array(channel["t"]), _numbers(channel["measured"]))

    def action_differences(self) -> None:
        """Change between the errors of the models and their curves."""
        self._differences = not self._differences
        for chart in self._charts:
            chart.query_one(Plot).action_whole()
        self._draw()


class OverlayScreen(Overlay):
    """Show the outputs of a recording with the complete model, and with the selected terms only."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.name, {"result": str(path.absolute())})
        self._complete: list[Channel] = []
        self.shown: frozenset[str] | None = None
        """The terms without which the model on the screen was simulated; None before the first."""

    async def show_line(self, line: dict[str, Any]) -> None:
        """Show the model with the terms of this line."""
        if "terms" in line:
            self._complete = line["channels"]
            await self.add_options({term: term for term in line["terms"]}, len(line["channels"]))
        self.shown = frozenset(line["without"])
        for chart, complete, channel in zip(self._charts, self._complete, line["channels"], strict=True):
            chart.show(f"{channel['name']}, {channel['unit']}", curves_of(complete, channel), keep_view=True)
        self.show_errors([_errors(*pair) for pair in zip(self._complete, line["channels"], strict=True)])
        self._show_progress()

    def _show_progress(self) -> None:
        """Show in the title whether the curves are up to date."""
        if self.shown is None:
            return
        self.show_title("" if self.shown == self._deselected() else " … simulating")

    def _deselected(self) -> frozenset[str]:
        selection_list = self.query_one(SelectionList)
        terms = [selection_list.get_option_at_index(i).value for i in range(selection_list.option_count)]
        return frozenset(terms) - frozenset(selection_list.selected)

    def on_selection_list_selected_changed(self, _event: Any) -> None:
        """Simulate with the selected terms."""
        if self.shown is not None and self._helper is not None:
            self._helper.send({"without": sorted(self._deselected())})
            self._show_progress()


def curves_of(complete: Channel, selected: Channel) -> list[PlotCurve]:
    """Return the curves of an output: measured, with all terms, and with the selected ones."""
    t, measured = np.array(complete["t"]), _measured_curve(complete)
    model = PlotCurve(t, _numbers(selected["simulated"]), "curve-0", Pen.SOLID, "model")
    if not selected["without"]:
        return [measured, model]
    all_terms = PlotCurve(t, _numbers(complete["simulated"]), "curve-1", Pen.DASHED, "all terms")
    return [measured, all_terms, model]


def _measured_curve(channel: Channel) -> PlotCurve:
    measured = _numbers(channel["measured"])
    return PlotCurve(np.array(channel["t"]), measured, "curve-measured", Pen.DOTS, "measured")


def _errors(complete: Channel, selected: Channel) -> str:
    """RMSE of an output, and its RMSE with all terms."""
    text = f"{selected['name']}: RMSE {_error(selected)}"
    return f"{text}, all terms {_error(complete)}" if selected["without"] else text


def _error(channel: Channel) -> str:
    return "unknown" if channel["rmse"] is None else f"{channel['rmse']:.3g} {channel['unit']}"


def _numbers(values: list[float | None]) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values])
