"""The checks and the hook before and after the steps of a run, with every device in its safe state."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from labhil.errors import LabhilError
from labhil.experiment.devices import Devices
from labhil.experiment.experiment import Experiment
from labhil.experiment.hooks import Hook, RunContext

POLL_INTERVAL = 0.02
"""How often a run checks its conditions, s."""
Moment = Literal["before", "after"]
Poll = Callable[[], None]
"""Is called repeatedly while a run waits; raises the error that ends the run, such as an emergency stop."""


class AroundSteps:
    """Waits for the conditions before and after the steps, and calls the hook.

    Args:
        experiment: The experiment of the run.
        hook: Its hook, if it has one.
        recording: Where the recording will be.
        changed: Is set when something has changed, which ends a wait early.
    """

    def __init__(
        self, experiment: Experiment, hook: Hook | None, recording: Path, changed: threading.Event
    ) -> None:
        self._experiment, self._hook = experiment, hook
        self._recording, self._changed = recording, changed
        self._was_called = False

    def before(self, devices: Devices, poll: Poll) -> None:
        """Wait for the conditions before the steps, then call the hook.

        Raises:
            ConditionError: A condition did not hold in time.
            HookError: The hook failed.
        """
        self._wait("before", devices, poll)
        if self._hook is not None:
            self._wait_until(devices.all_heard, poll)
            self._was_called = True
            self._hook.call(self._context("before", devices), poll)

    def after(
        self, devices: Devices, poll: Poll, error: LabhilError | None, reason: str
    ) -> LabhilError | None:
        """Wait for the conditions after the steps, then call the hook; return the first failure.

        A run that has failed already (``error``) is not checked; its hook is called all the same.
        """
        failure: LabhilError | None = None
        if error is None:
            try:
                self._wait("after", devices, poll)
            except LabhilError as exc:
                failure = exc
        if self._hook is None or not self._was_called:
            return failure
        cause = error or failure
        context = self._context("after", devices, cause, reason if cause is None else str(cause))
        try:
            self._hook.call(context, lambda: None)  # the run has ended: nothing is polled that could raise
        except LabhilError as exc:
            failure = failure or exc
        return failure

    def _wait(self, at: Moment, devices: Devices, poll: Poll) -> None:
        if devices.watch(self._experiment.checks or (), at):
            self._wait_until(devices.checks_hold, poll)

    def _wait_until(self, holds: Callable[[], bool], poll: Poll) -> None:
        while not holds():
            self._changed.wait(POLL_INTERVAL)
            self._changed.clear()
            poll()

    def _context(
        self, moment: Moment, devices: Devices, error: LabhilError | None = None, reason: str = ""
    ) -> RunContext:
        section = self._experiment.experiment
        return RunContext(
            moment, section.name, self._recording, section.metadata(), devices.newest(), error, reason
        )
