"""The emergency stop of the terminal UI: its red line, and its effect."""

from __future__ import annotations

import time
from collections.abc import Callable

from rich.text import Text
from textual.app import App

from labhil.bus.latch import Latch
from labhil.errors import LabhilError
from labhil.service.emergency import Outcome
from labhil.tui.background import work_in_background
from labhil.tui.dialogs import Confirm
from labhil.tui.session import Session


def stop_note(latch: Latch, outcome: Outcome | None) -> Text:
    """Return the red line: who pressed the stop, which devices are safe, and who did not answer."""
    text = Text(f"■ EMERGENCY STOP at {time.strftime('%H:%M:%S', time.localtime(latch.since))}", style="bold")
    text.append(f" by {latch.by}. ", style="not bold")
    if outcome is not None:
        unsafe = [*outcome.failed, *outcome.silent]
        if unsafe:
            text.append(
                f"NO PROPER ANSWER from {', '.join(unsafe)}: switch the power off. ", style="bold reverse"
            )
        if outcome.answered:
            text.append(f"Safe: {', '.join(outcome.answered)}. ")
    return text.append("F9 releases it.")


class EmergencyStop:
    """Stop every device in reach, and release the stop.

    Devices are stopped in a thread, so that the screen stays responsive.

    Args:
        app: Runs the threads, and shows the question before a release.
        session: Reaches the devices, and knows the latch, whoever set it.
        show: Draws the red line, and returns whether there was a screen to draw on.
        log: Writes a line (kind, text, device) to the log of the run.
    """

    def __init__(
        self, app: App[None], session: Session, show: Callable[[], bool], log: Callable[[str, str, str], None]
    ) -> None:
        self._app, self._session, self._show, self._log = app, session, show, log
        self.latch: Latch | None = None
        """The stop that is in force; None while runs are allowed."""
        self.outcome: Outcome | None = None
        """The devices' answers to this screen's own stop."""
        self.is_asking = False
        """Whether the question before a release is on the screen."""
        self._is_shown = True

    def press(self) -> None:
        """Bring every device in reach to its safe state, and block all runs until the release."""
        self.outcome = None
        work_in_background(self._app, self._stop_devices, "the emergency stop", "stop")

    def ask_release(self) -> None:
        """Allow runs again, once somebody has confirmed it."""

        def on_answer(yes: bool | None) -> None:
            self.is_asking = False
            self._app.refresh_bindings()
            if yes:
                work_in_background(self._app, self._release, "the release of the emergency stop", "stop")

        self.is_asking = True
        question = "Release the emergency stop?\n\nNothing moves by that; devices may be commanded again."
        self._app.push_screen(Confirm(question, "Release", "Keep it"), on_answer)

    def refresh(self) -> None:
        """Show the stop that is in force, whoever pressed it."""
        latch = self._session.latch
        if latch == self.latch and self._is_shown:
            return
        self.latch = latch
        if latch is None:
            self.outcome = None
        self._is_shown = self._show()

    def note(self) -> Text:
        """Return the red line; empty while no stop is in force."""
        return Text() if self.latch is None else stop_note(self.latch, self.outcome)

    def _stop_devices(self) -> None:
        try:
            outcome = self._session.stop_all("emergency stop in the terminal UI")
        except BaseException as error:
            outcome = Outcome({}, {"every device": f"the stop itself failed: {error!r}"}, ())
            self._app.call_later(self._take_outcome, outcome)
            raise
        self._app.call_later(self._take_outcome, outcome)

    def _take_outcome(self, outcome: Outcome) -> None:
        self.outcome = outcome
        for name, state in outcome.answered.items():
            self._log("stop all", f"in its safe state, {state}", name)
        for name, why in outcome.failed.items():
            self._log("stop all", f"did not stop properly: {why}", name)
        for name in outcome.silent:
            self._log("stop all", "NO ANSWER: switch its power off", name)
        self._is_shown = False
        self.refresh()

    def _release(self) -> None:
        try:
            self._session.release()
        except LabhilError as error:
            self._app.call_later(self._app.notify, str(error), severity="error")
            return
        self._app.call_later(self._log, "released", "runs may be started again", "")
        self._app.call_later(self.refresh)
