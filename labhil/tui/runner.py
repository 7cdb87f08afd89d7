"""The run of this screen, if there is one: started, controlled and followed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from labhil.campaign.studies.process import Helper

OVER = ("idle", "finished", "failed")


class Runner:
    """Holds at most one run process; ``on_line`` gets its lines in a thread of its own.

    The lines come back through :meth:`take`, in the thread of the screen, which owns all state here.
    """

    def __init__(self, folder: Path, on_line: Callable[[dict[str, Any]], object]) -> None:
        self._folder, self._on_line = folder, on_line
        self._helper: Helper | None = None
        self._number = 0
        self.state = "idle"
        self.reason = ""
        self.elapsed = 0.0
        self.duration = 0.0
        self.name = ""

    @property
    def active(self) -> bool:
        """Whether a run is on, or is still being ended."""
        return self._helper is not None and self._helper.running and self.state not in OVER

    def start(self, experiment: Path, name: str) -> None:
        """Start a run; the one before must be over."""
        if self._helper is not None:
            self._helper.close()
        self.state, self.reason, self.elapsed, self.duration, self.name = "starting", "", 0.0, 0.0, name
        request = {"experiment": str(experiment.absolute()), "out": str(self._folder.absolute())}
        self._number += 1
        number, on_line = self._number, self._on_line
        self._helper = Helper(
            "the run", "labhil.tui.running", request, lambda line: on_line({**line, "number": number})
        )

    def ask(self, what: str, reason: str = "") -> None:
        """Request ``pause``, ``resume``, ``stop`` or ``abort``."""
        if self._helper is not None:
            self._helper.send({"do": what, "reason": reason or f"{what} in the terminal UI"})

    def end_unseen(self, failure: str) -> None:
        """End the run where the screen no longer sees what its devices do; ``failure`` is why, or empty."""
        if failure and self.active and self.state != "aborting":
            self.ask("abort", f"the terminal UI no longer sees the devices: {failure}"[:200])

    def mark(self, text: str, at_ns: int) -> None:
        """Put a marker into the recording of the run, at ``at_ns`` of the machine's steady clock."""
        if self._helper is not None:
            self._helper.send({"do": "mark", "text": text, "steady_ns": at_ns})

    def take(self, line: dict[str, Any]) -> None:
        """Take a line of the run process; lines of an earlier run are ignored."""
        if line["number"] != self._number:
            return
        if "state" in line:
            self.state, self.elapsed, self.duration = line["state"], line["elapsed"], line["duration"]
            self.reason = line["message"] or self.reason
        elif "refused" in line:
            self.reason = line["refused"]
        elif "result" in line:
            if self.state not in OVER:  # it failed before there was a run
                self.state = "failed"
            self.reason = line["error"] or (line["result"] or {}).get("reason", "")
        elif "ended" in line and self.state not in OVER:
            self.state, self.reason = "failed", line["complaint"] or "the run process died"

    def close(self) -> None:
        """End a run that is on, in order, and wait for it."""
        if self._helper is not None:
            self._helper.close()
