"""The states of a run, their transitions, and the handle that controls a run.

:data:`TRANSITIONS` is their only definition; the picture in ``docs/explanation/safety.md`` is drawn from it.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from enum import StrEnum
from types import MappingProxyType

from labhil.errors import CommandRefusedError
from labhil.host_clock import unix_ns


class RunState(StrEnum):
    """The state of a run; every transition is an event in the recording, with its reason."""

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
"""For each state the states that may follow, and what leads to them."""


RECORDED = (RunState.STARTING, RunState.RUNNING, RunState.PAUSED)
"""The states in which a marker is recorded."""
MAX_MARK_LENGTH = 500
"""Characters of a marker that are kept."""


class RunControl:
    """A handle to pause, resume, stop or abort one run, from any thread.

    Each request returns at once and is carried out by the thread of the run; :meth:`wait_for` waits for that.
    A request that the present state does not allow raises CommandRefusedError and changes nothing. ``stop``
    ends the run with exit status 0, ``abort`` with exit status 1. Both leave every device in its safe state
    and the recording complete.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._state = RunState.IDLE
        self._reason = ""
        self._requested: RunState | None = None
        self._request_reason = ""
        self._refusal = ""
        self._marks: list[tuple[int, str]] = []
        self.changed = threading.Event()
        """Is set when the run has something to handle: a request, or news of its devices."""

    @property
    def state(self) -> RunState:
        """The state of the run."""
        return self._state

    @property
    def reason(self) -> str:
        """The reason of the last transition."""
        return self._reason

    def pause(self, reason: str = "paused by its operator") -> None:
        """Bring every device to its safe state and stop the clocks of the steps."""
        self._request(RunState.PAUSED, reason, "paused")

    def resume(self) -> None:
        """Take the leases again and continue where the run was paused.

        A device outside its limits refuses: the run then stays paused and :attr:`refusal` gives the reason.
        """
        if self._state is not RunState.PAUSED:
            raise CommandRefusedError(
                f"a run that is {self._state.value} cannot be resumed; only one that is paused"
            )
        self._request(RunState.RUNNING, "resumed", "resumed")

    def stop(self, reason: str = "stopped by its operator") -> None:
        """End the run in order, with exit status 0."""
        self._request(RunState.STOPPING, reason, "stopped")

    def abort(self, reason: str = "aborted by its operator") -> None:
        """End the run with exit status 1; devices become safe and the recording is kept all the same."""
        self._request(RunState.ABORTING, reason, "aborted")

    def wait_for(self, *states: RunState, timeout: float) -> bool:
        """Wait until the run is in one of ``states``, and return whether it is.

        Args:
            states: The states.
            timeout: Longest wait, s. It ends early where the run has ended or refused the request.
        """
        with self._condition:
            self._condition.wait_for(lambda: self._is_decided(states), timeout)
            return self._state in states

    @property
    def refusal(self) -> str:
        """Why the last request could not be carried out; empty where it was, or is still pending."""
        return self._refusal

    def mark(self, text: str, age_ns: int = 0) -> None:
        """Put a marker into the recording.

        Args:
            text: Text of the marker.
            age_ns: Age of the marked moment, ns: a text takes time to type.

        Raises:
            CommandRefusedError: The text is empty, or nothing is recorded in this state.
        """
        text = " ".join(text.split())[:MAX_MARK_LENGTH]
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

    def _request(self, state: RunState, reason: str, participle: str) -> None:
        with self._condition:
            if state not in TRANSITIONS[self._state]:
                possible = ", ".join(origin.value for origin in _predecessors(state))
                raise CommandRefusedError(
                    f"a run that is {self._state.value} cannot be {participle}; only one that is {possible}"
                )
            # a request to pause or to resume does not cancel a request to end
            if self._requested in _ENDS and state not in _ENDS:
                raise CommandRefusedError(f"the run is about to end: {self._request_reason}")
            self._requested, self._request_reason, self._refusal = state, reason, ""
            self.changed.set()

    def _is_decided(self, states: tuple[RunState, ...]) -> bool:
        return self._state in states or bool(self._refusal) or not TRANSITIONS[self._state]

    # the run's side

    def is_to_end(self) -> bool:
        """Return whether an end is requested that the run has not begun yet."""
        return self._requested in _ENDS

    def take_request(self) -> tuple[RunState, str] | None:
        """Return the last requested state and its reason, once; None without a request. For the run."""
        with self._condition:
            state, self._requested = self._requested, None
            return None if state is None else (state, self._request_reason)

    def take_marks(self) -> list[tuple[int, str]]:
        """Return the new markers, each with its Unix time in ns. For the run."""
        with self._condition:
            marks, self._marks = self._marks, []
            return marks

    def refuse(self, reason: str) -> None:
        """Note that the last request could not be carried out. For the run."""
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
    return (origin for origin, successors in TRANSITIONS.items() if state in successors)
