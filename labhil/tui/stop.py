"""The emergency stop as it is seen: a button that is always there, and the line that says who is safe."""

from __future__ import annotations

import time

from rich.text import Text
from textual.events import Click
from textual.widgets import Static

from labhil.bus.latch import Latch
from labhil.service.emergency import Outcome


def stop_note(standing: Latch, outcome: Outcome | None) -> Text:
    """What the red line says: who pressed it, who is safe, and above all who did not answer."""
    text = Text(
        f"■ EMERGENCY STOP at {time.strftime('%H:%M:%S', time.localtime(standing.since))}", style="bold"
    )
    text.append(f" by {standing.by}. ", style="not bold")
    if outcome is not None:
        bad = [*outcome.failed, *outcome.silent]
        if bad:
            text.append(
                f"NO PROPER ANSWER from {', '.join(bad)}: switch the power off. ", style="bold reverse"
            )
        if outcome.answered:
            text.append(f"Safe: {', '.join(outcome.answered)}. ")
    return text.append("F9 releases it.")


class StopButton(Static):
    """The emergency stop for who has a mouse at hand."""

    def on_click(self, event: Click) -> None:
        """Stop everything."""
        event.stop()
        self.app.call_later(self.app.run_action, "stop_all")
