"""The states of a run, which may follow which, and the handle that others control it by.

:data:`TRANSITIONS` is the only place that says what may follow what; the picture in
``docs/explanation/safety.md`` is drawn from it.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from enum import StrEnum
from types import MappingProxyType

from labhil.errors import CommandRefusedError
from labhil.host_clock import unix_ns


class RunState(StrEnum):
    """What a run is doing; every change is an event in the recording, with its reason."""

    IDLE = "idle"
    """Nothing has been started yet."""
    STARTING = "starting"
    """Hosts connect to their devices; every device is in its safe state."""
    RUNNING = "running"
    """The devices follow their steps."""
    PAUSED = "paused"
    """Every device is in its safe state and the clocks of the steps stand still; samples are recorded."""
    STOPPING = "stopping"
    """The orderly end: the steps are done, or were ended by request."""
    ABORTING = "aborting"
    """The end by an error, an interruption or :meth:`RunControl.abort`."""
    FINISHED = "finished"
    FAILED = "failed"


_EITHER_END = {RunState.STOPPING: "stop", RunState.ABORTING: "abort, error, Ctrl+C"}

TRANSITIONS: Mapping[RunState, Mapping[RunState, str]] = MappingProxyType(
    {
        RunState.IDLE: {RunState.STARTING: "run", **_EITHER_END},
        RunState.STARTING: {RunState.RUNNING: "all devices connected", **_EITHER_END},
        RunState.RUNNING: {
            RunState.PAUSED: "pause",
            RunState.STOPPING: "steps done, stop",
            RunState.ABORTING: "abort, error, Ctrl+C",
        },
        RunState.PAUSED: {RunState.RUNNING: "resume", **_EITHER_END},
        RunState.STOPPING: {
            RunState.FINISHED: "devices safe, recording complete",
            RunState.FAILED: "a device did not stop, a check or hook failed",
        },
        RunState.ABORTING: {RunState.FAILED: "devices safe, recording complete"},
        RunState.FINISHED: {},
        RunState.FAILED: {},
    }
)
"""From each state, those that may follow, and what leads there."""


RECORDED = (RunState.STARTING, RunState.RUNNING, RunState.PAUSED)
"""The states in which a marker is recorded."""
LONGEST_MARK = 500
"""Characters of a marker that are kept."""


class RunControl:
    """A handle on one run, for any thread: pause it, resume it, stop it, abort it.

    Each request returns at once and is carried out by the run's own thread; :meth:`wait_for` waits until
    it has been. A request that the present state does not allow raises CommandRefusedError and changes
    nothing. ``stop`` ends the run with exit status 0: what was recorded is what was wanted. ``abort`` ends
    it with exit status 1. Both leave every device in its safe state and the recording complete.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._state = RunState.IDLE
        self._reason = ""
        self._wanted: RunState | None = None
        self._because = ""
        self._refusal = ""
        self._marks: list[tuple[int, str]] = []
        self.changed = threading.Event()
        """Set when there is something for the run to look at: a request, or what its devices did."""

    @property
    def state(self) -> RunState:
        """What the run is doing."""
        return self._state

    @property
    def reason(self) -> str:
        """Why it does that, in words."""
        return self._reason

    def pause(self, reason: str = "paused by its operator") -> None:
        """Bring every device to its safe state and let the clocks of the steps stand still."""
        self._want(RunState.PAUSED, reason, "paused")

    def resume(self) -> None:
        """Take the leases again and go on where the run was paused.

        A device outside its limits refuses that: the run stays paused and :attr:`refusal` says why.
        """
        if self._state is not RunState.PAUSED:
            raise CommandRefusedError(
                f"a run that is {self._state.value} cannot be resumed; only one that is paused"
            )
        self._want(RunState.RUNNING, "resumed", "resumed")

    def stop(self, reason: str = "stopped by its operator") -> None:
        """End the run in order, with exit status 0; the recording is kept."""
        self._want(RunState.STOPPING, reason, "stopped")

    def abort(self, reason: str = "aborted by its operator") -> None:
        """End the run with exit status 1; devices become safe just the same and the recording is kept."""
        self._want(RunState.ABORTING, reason, "aborted")

    def wait_for(self, *states: RunState, timeout: float) -> bool:
        """Wait up to ``timeout`` s until the run is in one of ``states``; whether it is.

        Returns early where the run cannot get there any more or has refused to.
        """
        with self._condition:
            self._condition.wait_for(lambda: self._is_settled(states), timeout)
            return self._state in states

    @property
    def refusal(self) -> str:
        """Why the last request could not be carried out; empty when it was, or is still on its way."""
        return self._refusal

    def mark(self, text: str, age_ns: int = 0) -> None:
        """Put a marker into the recording; CommandRefusedError where nothing is recorded.

        It stands at the moment ``age_ns`` ago: a text takes longer to type than a key to press.
        """
        text = " ".join(text.split())[:LONGEST_MARK]
        if not text:
            raise CommandRefusedError("a marker needs a text")
        with self._condition:
            if self._state not in RECORDED:
                raise CommandRefusedError(
                    f"a run that is {self._state.value} takes no marker; only one that is "
                    f"{', '.join(state.value for state in RECORDED)}"
                )
            self._marks.append((unix_ns() - max(age_ns, 0), text))
            self.changed.set()

    def _want(self, state: RunState, reason: str, participle: str) -> None:
        with self._condition:
            if state not in TRANSITIONS[self._state]:
                possible = ", ".join(origin.value for origin in _predecessors(state))
                raise CommandRefusedError(
                    f"a run that is {self._state.value} cannot be {participle}; only one that is {possible}"
                )
            # a request to end is not taken back by one to pause or to go on
            if self._wanted in _ENDS and state not in _ENDS:
                raise CommandRefusedError(f"the run is about to end: {self._because}")
            self._wanted, self._because, self._refusal = state, reason, ""
            self.changed.set()

    def _is_settled(self, states: tuple[RunState, ...]) -> bool:
        return self._state in states or bool(self._refusal) or not TRANSITIONS[self._state]

    # the run's side

    def is_to_end(self) -> bool:
        """Whether an end is requested that the run has not begun yet."""
        return self._wanted in _ENDS

    def take_request(self) -> tuple[RunState, str] | None:
        """Return the last requested state and its reason, once; None without a request. For the run."""
        with self._condition:
            state, self._wanted = self._wanted, None
            return None if state is None else (state, self._because)

    def take_marks(self) -> list[tuple[int, str]]:
        """Return the markers that were set since, each with its Unix time in ns. For the run."""
        with self._condition:
            marks, self._marks = self._marks, []
            return marks

    def refuse(self, reason: str) -> None:
        """Say that the last request could not be carried out. For the run."""
        with self._condition:
            self._refusal = reason
            self._condition.notify_all()

    def become(self, state: RunState, reason: str) -> None:
        """Change the state; ValueError for a change that :data:`TRANSITIONS` does not know. For the run."""
        with self._condition:
            if state not in TRANSITIONS[self._state]:
                raise ValueError(f"a run that is {self._state.value} cannot become {state.value}")
            self._state, self._reason = state, reason
            self._condition.notify_all()


_ENDS = (RunState.STOPPING, RunState.ABORTING)


def _predecessors(state: RunState) -> Iterator[RunState]:
    return (before for before, following in TRANSITIONS.items() if state in following)
