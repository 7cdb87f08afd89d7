"""The run of this screen: started, controlled and followed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from labhil.campaign.studies.process import Helper

FINAL_STATES = ("idle", "finished", "failed")


class Runner:
    """Control at most one run process.

    Its lines come back through :meth:`handle_line`, in the thread of the screen, which owns all state here.

    Args:
        folder: Where recordings go.
        on_line: Gets the lines of the process, in a thread of its own.
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
    def is_active(self) -> bool:
        """Whether a run is under way, or is still being ended."""
        return self._helper is not None and self._helper.running and self.state not in FINAL_STATES

    def start(self, experiment: Path, name: str) -> None:
        """Start a run; the one before must have ended.

        Args:
            experiment: The experiment file.
            name: Name of the run on the screen.
        """
        if self._helper is not None:
            self._helper.close()
        self.state, self.reason, self.elapsed, self.duration, self.name = "starting", "", 0.0, 0.0, name
        request = {"experiment": str(experiment.absolute()), "out": str(self._folder.absolute())}
        self._number += 1
        number, on_line = self._number, self._on_line
        self._helper = Helper(
            "the run", "labhil.tui.run_process", request, lambda line: on_line({**line, "number": number})
        )

    def request(self, what: str, reason: str = "") -> None:
        """Request a change of the state of the run.

        Args:
            what: ``pause``, ``resume``, ``stop`` or ``abort``.
            reason: Reason in the recording.
        """
        if self._helper is not None:
            self._helper.send({"do": what, "reason": reason or f"{what} in the terminal UI"})

    def abort_if_unseen(self, failure: str) -> None:
        """Abort the run where the view of its devices has failed (``failure``, or empty)."""
        if failure and self.is_active and self.state != "aborting":
            self.request("abort", f"the terminal UI no longer sees the devices: {failure}"[:200])

    def mark(self, text: str, at_ns: int) -> None:
        """Put a marker into the recording of the run.

        Args:
            text: Text of the marker.
            at_ns: Its time by the steady clock of the machine.
        """
        if self._helper is not None:
            self._helper.send({"do": "mark", "text": text, "steady_ns": at_ns})

    def handle_line(self, line: dict[str, Any]) -> None:
        """Follow a line of the run process; lines of an earlier run are ignored."""
        if line["number"] != self._number:
            return
        if "state" in line:
            self.state, self.elapsed, self.duration = line["state"], line["elapsed"], line["duration"]
            self.reason = line["message"] or self.reason
        elif "refused" in line:
            self.reason = line["refused"]
        elif "result" in line:
            if self.state not in FINAL_STATES:  # it failed before there was a run
                self.state = "failed"
            self.reason = line["error"] or (line["result"] or {}).get("reason", "")
        elif "ended" in line and self.state not in FINAL_STATES:
            self.state, self.reason = "failed", line["complaint"] or "the run process died"

    def close(self) -> None:
        """End a run in order, and wait for it."""
        if self._helper is not None:
            self._helper.close()
