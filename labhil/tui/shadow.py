"""The live shadow: an accepted model simulated beside a device, with its residual and band.

``shadow_process.py`` simulates, ``shadow_state.py`` holds the state.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.message import Message
from textual.widgets import Static

from labhil.campaign.studies.process import Helper
from labhil.tui import clock
from labhil.tui.background import work_in_background
from labhil.tui.curve import Pen, PlotCurve
from labhil.tui.plot import Chart
from labhil.tui.session import SignalSource
from labhil.tui.shadow_state import ShadowedOutput, ShadowState

MODULE = "labhil.tui.shadow_process"
ROOM_FOR_ORIGIN = 100
"""Columns that the origin of the band needs."""

PATIENCE = 0.2
"""Time for the process to end by itself, s."""

MOST_SHOWN = 6
"""Outputs that have a line; the chart shows the residual that is farthest beyond its band."""


@dataclass
class ShadowLine(Message):
    """Carry a line of the process of shadow ``number``."""

    number: int
    line: dict[str, Any]


class ShadowView(Vertical):
    """Show whether the model agrees, and a chart of the residual with its band."""

    def __init__(self) -> None:
        super().__init__(id="live-shadow")
        self._helper: Helper | None = None
        self._number = 0
        self._shown_lines = Text()
        self.state: ShadowState | None = None
        """State of the shadow; None where there is none."""

    def compose(self) -> ComposeResult:
        """Lay out the lines and the chart."""
        yield Static(id="shadow-lines")
        yield Chart(id="shadow-chart")

    def on_mount(self) -> None:
        """Hide the view until there is a shadow."""
        self.display = False

    def on_unmount(self) -> None:
        """End the process."""
        if self._helper is not None:
            self._helper.close(PATIENCE)

    def start(self, source: SignalSource, model: Path) -> None:
        """Simulate a model along the stream of a signal, instead of any earlier one.

        Args:
            source: A signal of the stream.
            model: File of the model.
        """
        self.stop()
        self._number += 1
        number = self._number
        self.state = ShadowState(source.device, model.name)
        request = {
            "endpoint": source.endpoint,
            "device": source.device,
            "stream": source.stream,
            "model": str(model.absolute()),
        }
        self._helper = Helper(
            "the shadow", MODULE, request, lambda line: self.post_message(ShadowLine(number, line))
        )
        self.display = True
        self.draw(1.0)

    def stop(self) -> None:
        """End the shadow and hide it; a thread waits for the process, so that no key does."""
        helper, self._helper = self._helper, None
        if helper is not None:
            work_in_background(self, lambda: helper.close(PATIENCE), "ending the shadow", "shadow")
        self.state = None
        self.display = False

    def on_shadow_line(self, message: ShadowLine) -> None:
        """Update the state; lines of an earlier shadow are ignored."""
        message.stop()
        if self.state is not None and message.number == self._number:
            self.state.handle_line(message.line)

    def draw(self, window: float) -> None:
        """Show the newest state, and the residuals of the last ``window`` s."""
        state = self.state
        if state is None or not self.is_attached:
            return
        colours, now_ns = self.app.theme_variables, clock.clock_ns() + state.ahead_ns
        rows = state.rows(colours, now_ns, wide=self._is_wide)[:MOST_SHOWN]
        line_end = Text("\n", no_wrap=True, overflow="ellipsis")
        lines = line_end.join([state.title(colours, now_ns), *rows])
        if lines != self._shown_lines:
            changed = len(lines.plain.splitlines()) != len(self._shown_lines.plain.splitlines())
            self._shown_lines = lines
            self.query_one("#shadow-lines", Static).update(lines, layout=changed)
        chart = self.query_one(Chart)
        chart.display = bool(state.outputs)
        if state.outputs:
            worst = max(state.outputs.values(), key=lambda output: output.beyond)
            self._draw_residual(chart, worst, window, now_ns)

    @property
    def _is_wide(self) -> bool:
        return self.size.width >= ROOM_FOR_ORIGIN

    def _draw_residual(self, chart: Chart, output: ShadowedOutput, window: float, now_ns: int) -> None:
        colours = self.app.theme_variables
        ago, residual = output.residual(now_ns)
        shown = ago >= -window
        ago, residual = ago[shown], residual[shown]
        low, high = float(np.nanmin(residual, initial=0.0)), float(np.nanmax(residual, initial=0.0))
        limits = (min(-1.3 * output.band, 1.1 * low), max(1.3 * output.band, 1.1 * high))
        colour = "curve-1" if output.left_at is None else "curve-4"
        edges = [
            PlotCurve(np.array([-window, 0.0]), np.full(2, side * output.band), "muted", Pen.DASHED)
            for side in (1.0, -1.0)
        ]
        curve = PlotCurve(ago, residual, colour)
        title = Text.assemble(
            (f"residual of {output.name}", f"bold {colours[colour]}"), (", noise levels", colours["muted"])
        )
        band = Text("╍╍ band", style=colours["muted"])
        if self.state is not None and self._is_wide:
            band.append(f", {self.state.about()}")
        chart.show(title, [*edges, curve], (-window, 0.0), limits, value=band)
