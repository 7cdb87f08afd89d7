"""The emergency stop as a file: while it exists, no host of this user leaves its safe state.

Every host reads it twenty times a second and before it gives a lease, so that the stop holds without the bus,
across runs, and for hosts that start later.
"""

from __future__ import annotations

import contextlib
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from labhil.bus.register import runtime_directory, write_atomically
from labhil.documents import parse_json
from labhil.errors import BusError

MAX_OTHERS = 8
"""Names of further people who press the stop that are kept."""


@dataclass(frozen=True, slots=True)
class Latch:
    """Who pressed the emergency stop, why, and when (Unix time, s); ``others`` pressed it while it stood."""

    by: str
    reason: str
    since: float
    others: tuple[str, ...] = ()

    def describe(self) -> str:
        """Describe the stop for a person."""
        at = time.strftime("%H:%M:%S", time.localtime(self.since))
        again = f"; pressed again by {', '.join(self.others)}" if self.others else ""
        return f"emergency stop by {self.by} at {at}: {self.reason}{again}"


def latch_path() -> Path:
    """Return the path of the file."""
    return runtime_directory() / "emergency_stop"


def press(by: str, reason: str) -> Latch:
    """Latch the stop; a stop that is pressed already is kept, with ``by`` among those who pressed it."""
    standing = read_latch()
    if standing is None:
        standing = Latch(by, reason, time.time())
        write_atomically(latch_path(), json.dumps(asdict(standing)))
    elif by not in (standing.by, *standing.others) and len(standing.others) < MAX_OTHERS:
        standing = replace(standing, others=(*standing.others, by))
        with contextlib.suppress(BusError):  # the stop is pressed in any case
            write_atomically(latch_path(), json.dumps(asdict(standing)))
    return standing


def read_latch() -> Latch | None:
    """Return the stop that is pressed; None where none is. An unreadable file counts as a stop."""
    try:
        text = latch_path().read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return None
    with contextlib.suppress(ValueError, TypeError, KeyError):
        data = parse_json(text)
        others = tuple(str(name) for name in data.get("others", ()))
        return Latch(str(data["by"]), str(data["reason"]), float(data["since"]), others)
    return Latch("somebody", "the file that says more cannot be read", time.time())


def release() -> bool:
    """Remove the file, and return whether there was one."""
    standing = latch_path().exists()
    latch_path().unlink(missing_ok=True)
    return standing
