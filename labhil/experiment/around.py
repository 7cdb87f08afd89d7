"""What happens around the steps of a run: its checks, and its hook, with every device in its safe state."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from labhil.errors import LabhilError
from labhil.experiment.devices import Devices
from labhil.experiment.experiment import Experiment
from labhil.experiment.hooks import Hook, RunContext

INTERVAL = 0.02
"""How often a run looks whether its conditions hold, s."""
Moment = Literal["before", "after"]
Look = Callable[[], None]


class AroundSteps:
    """Waits for the conditions before and after the steps, and calls the hook.

    ``look`` is called again and again meanwhile; it raises what ends the run, such as an emergency stop.

    Args:
        experiment: The experiment of the run.
        hook: What it calls, if anything.
        recording: Where the recording will be.
        changed: Set when there is something to look at.
    """

    def __init__(
        self, experiment: Experiment, hook: Hook | None, recording: Path, changed: threading.Event
    ) -> None:
        self._experiment, self._hook = experiment, hook
        self._recording, self._changed = recording, changed
        self._was_called = False

    def before(self, devices: Devices, look: Look) -> None:
        """Wait for what has to hold before the steps, then call the hook.

        Raises:
            ConditionError: A condition did not hold in time.
            HookError: The hook has failed.
        """
        self._wait("before", devices, look)
        if self._hook is not None:
            self._wait_until(devices.all_heard, look)
            self._was_called = True
            self._hook.call(self._context("before", devices), look)

    def after(
        self, devices: Devices, look: Look, error: LabhilError | None, reason: str
    ) -> LabhilError | None:
        """Wait for what has to hold after the steps, then call the hook; return the first failure.

        A run that has failed already (``error``) is not checked; its hook is called all the same.
        """
        failure: LabhilError | None = None
        if error is None:
            try:
                self._wait("after", devices, look)
            except LabhilError as exc:
                failure = exc
        if self._hook is None or not self._was_called:
            return failure
        failed = error or failure
        context = self._context("after", devices, failed, reason if failed is None else str(failed))
        try:
            self._hook.call(context, lambda: None)  # whatever ended the run is no reason to cut this short
        except LabhilError as exc:
            failure = failure or exc
        return failure

    def _wait(self, at: Moment, devices: Devices, look: Look) -> None:
        if devices.watch(self._experiment.checks or (), at):
            self._wait_until(devices.checks_hold, look)

    def _wait_until(self, holds: Callable[[], bool], look: Look) -> None:
        while not holds():
            self._changed.wait(INTERVAL)
            self._changed.clear()
            look()

    def _context(
        self, moment: Moment, devices: Devices, error: LabhilError | None = None, reason: str = ""
    ) -> RunContext:
        section = self._experiment.experiment
        return RunContext(
            moment, section.name, self._recording, section.metadata(), devices.newest(), error, reason
        )
