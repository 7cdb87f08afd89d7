"""The host's clock for stamps: Unix time that nobody sets while a session runs.

The wall clock of a machine is set now and then, by hand, by NTP, or after a suspend, and then it jumps.
Stamps are made from ``CLOCK_BOOTTIME`` instead, which only goes on, counts the time of a suspend, and is
one for all processes of a machine. What it lacks to be Unix time is measured once, when a session begins,
and handed down to the processes of the session in their environment: hosts, twins, recorder and runner
stamp alike.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

OFFSET_VARIABLE = "LABHIL_CLOCK_OFFSET_NS"
"""The environment variable that holds Unix time less the steady clock, ns."""

READINGS = 9
"""The offset is the one whose two readings lay closest together: nothing came in between them."""

_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Linux has it; elsewhere (macOS) the monotonic clock goes on through a suspend, too."""


class _Anchor:
    """The offset of this process, and how many sessions rest on it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sessions = 0
        self._offset_ns: int | None = None

    def offset_ns(self) -> int:
        if self._offset_ns is None:
            with self._lock:
                if self._offset_ns is None:
                    self._offset_ns = _inherit_offset()
        return self._offset_ns

    def open_session(self) -> int:
        with self._lock:
            if self._sessions == 0 or self._offset_ns is None:
                self._offset_ns = _measure_offset()
                os.environ[OFFSET_VARIABLE] = str(self._offset_ns)
            self._sessions += 1
            return self._offset_ns

    def close_session(self) -> None:
        with self._lock:
            self._sessions -= 1
            if self._sessions == 0:
                # what this process stamps later goes on from here; a process started later is of no session
                os.environ.pop(OFFSET_VARIABLE, None)


_anchor = _Anchor()


def unix_ns() -> int:
    """Return Unix time by the session's clock, ns; it never goes back and never jumps."""
    return steady_ns() + offset_ns()


def steady_ns() -> int:
    """Return the machine's steady clock, ns since it was started, suspends included."""
    return time.clock_gettime_ns(_CLOCK)


def offset_ns() -> int:
    """Return what is added to :func:`steady_ns`: handed down, or measured at the first call."""
    return _anchor.offset_ns()


@contextmanager
def session_clock() -> Iterator[int]:
    """Measure the offset anew for a session that begins, and hand it down to the processes it starts.

    Within it all stamps are of one clock: a session inside another one, or beside it in the same process,
    keeps the offset that stands.

    Yields:
        The offset, ns.
    """
    offset = _anchor.open_session()
    try:
        yield offset
    finally:
        _anchor.close_session()


class SuspendWatch:
    """Notices that the machine was suspended: the monotonic clock stood still, and the steady one did not."""

    def __init__(self) -> None:
        self._asleep_ns = _asleep_ns()

    def slept(self) -> float:
        """Return for how long the machine was suspended since the last call, s; some µs mean nothing."""
        before_ns, self._asleep_ns = self._asleep_ns, _asleep_ns()
        return (self._asleep_ns - before_ns) * 1e-9


class HostClockWatch:
    """Notices between two looks what happened to the machine's clocks: the wall clock set, a suspend.

    Stamps do not jump by either, but whoever compares them with other times, or wonders where the samples of
    a minute are, has to know. Changes below ``smallest`` s are not named: NTP slews a clock all the time.
    """

    def __init__(self, smallest: float = 0.1) -> None:
        self._smallest = smallest
        self._wall_ns, self._suspends = _measure_offset(), SuspendWatch()

    def look(self) -> list[tuple[str, str]]:
        """Return what has happened since the last look: a kind of event and a sentence, each."""
        happened = []
        slept = self._suspends.slept()
        if slept >= self._smallest:
            happened.append(("suspended", f"the machine was suspended for {slept:.3g} s"))
        wall_ns = _measure_offset()
        step = (wall_ns - self._wall_ns) * 1e-9
        if abs(step) >= self._smallest:
            ahead = "ahead" if step > 0.0 else "back"
            message = f"the wall clock was set {ahead} by {abs(step):.6g} s; stamps go on as before"
            happened.append(("clock_set", message))
        self._wall_ns = wall_ns
        return happened


def _asleep_ns() -> int:
    """How long the machine has been suspended since it was started, ns; 0 where that cannot be known."""
    before = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    steady = steady_ns()
    after = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    return steady - (before + after) // 2


def _inherit_offset() -> int:
    try:
        return int(os.environ[OFFSET_VARIABLE])
    except (KeyError, ValueError):
        return _measure_offset()


def _measure_offset() -> int:
    readings = []
    for _ in range(READINGS):
        before = steady_ns()
        wall = time.time_ns()
        after = steady_ns()
        readings.append((after - before, wall - (before + after) // 2))
    return min(readings)[1]
