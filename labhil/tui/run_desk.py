"""What the application does with its run: it starts and follows it, and ends it before it quits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from textual.app import App

from labhil.campaign.studies.jobs import Job
from labhil.tui.bar import question_before_leaving
from labhil.tui.dialogs import Confirm
from labhil.tui.experiment import ExperimentPane
from labhil.tui.runner import Runner


class RunDesk:
    """Start a run, follow it, and quit only after it has ended in order.

    Args:
        app: The app.
        runner: The run.
        pane: Returns the pane of experiments; None where there is nothing to draw on.
        is_stopped: Whether the emergency stop is on.
        on_change: Called when the run is in another state.
        on_result: Called when a run has a result.
    """

    def __init__(
        self,
        app: App[Any],
        runner: Runner,
        pane: Callable[[], ExperimentPane | None],
        is_stopped: Callable[[], bool],
        on_change: Callable[[], None],
        on_result: Callable[[], None],
    ) -> None:
        self._app, self._runner, self._pane = app, runner, pane
        self._is_stopped, self._on_change, self._on_result = is_stopped, on_change, on_result
        self._is_leaving = False

    def ask_to_start(self, path: Path) -> None:
        """Start a run; ask first where it moves real devices."""
        pane = self._pane()
        if self._is_stopped():
            self._app.notify("The emergency stop is on: F9 releases it.", severity="error")
            return
        addresses = [] if pane is None else pane.moves_hardware()
        if not addresses:
            self._start(path)
            return

        def on_answer(yes: bool | None) -> None:
            if yes:
                self._start(path)

        question = f"This moves real devices:\n\n  {', '.join(addresses)}\n\nIs everybody out of their way?"
        self._app.push_screen(Confirm(question, "Start", "Not yet", danger=True), on_answer)

    def _start(self, path: Path) -> None:
        pane = self._pane()
        if pane is None or self._runner.is_active or self._is_stopped():
            return
        name = pane.plan.experiment.experiment.name if pane.plan is not None else path.stem
        self._runner.start(path, name)
        pane.log_line("starting", name)
        self._on_change()

    def follow(self, line: dict[str, Any]) -> None:
        """Follow the run by a line of its process."""
        before = self._runner.state
        self._runner.handle_line(line)
        pane = self._pane()
        if pane is None:
            return
        if "result" in line:
            pane.take_result(line["result"], line["error"])
            self._on_result()
        elif "refused" in line:
            pane.log_line("refused", line["refused"])
        if self._runner.state != before or "ended" in line:
            self._on_change()
        if self._is_leaving and not self._runner.is_active:
            self._app.exit()

    def leave(self, at_work: Sequence[Job]) -> None:
        """Quit; during a run only after a question, and after the run has ended in order.

        Args:
            at_work: Studies that have not ended; they are cancelled.
        """
        question = "" if self._is_leaving else question_before_leaving(self._runner, at_work)
        if not question:
            self._app.exit()
        elif not isinstance(self._app.screen, Confirm):
            self._app.push_screen(Confirm(question, "Stop and quit", "Stay"), self._leave)

    def _leave(self, yes: bool | None) -> None:
        if not yes:
            return
        if not self._runner.is_active:
            self._app.exit()
            return
        self._is_leaving = True
        self._runner.request("stop", "the terminal UI is quit")
        self._app.notify("Stopping the run …", timeout=30)
