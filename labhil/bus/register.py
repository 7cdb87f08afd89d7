"""The register of the buses on this machine: a small file for each process that others may reach.

A process that listens writes ``PID-NUMBER.json`` into a directory that only its user can read and removes it
at the end; the next reader removes the files of killed processes. ``PID-NUMBER.key`` beside it has the key of
the session, which authenticates commands: a user who can read that file can command. Loopback only.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from labhil.bus.authentication import KEY_BYTES
from labhil.documents import parse_json
from labhil.errors import BusError, UsageError

ENDPOINT = re.compile(r"[a-z]+/.*:\d{1,5}\Z")
LOOPBACK = re.compile(r"tcp/(127\.0\.0\.1|localhost|\[::1\]):\d{1,5}\Z")

_numbers = itertools.count()


@dataclass(frozen=True, slots=True)
class Registered:
    """A process that can be reached on its bus.

    Attributes:
        kind: What it is: "run", "lab", "host" or "replay".
        name: Its name.
        endpoint: Where its bus is joined.
        devices: Its devices.
        pid: Its process id.
        birth: When it started, which distinguishes it from a later process of the same id.
        since: When it was registered, Unix time, s.
    """

    kind: str
    name: str
    endpoint: str
    devices: tuple[str, ...]
    pid: int
    birth: str
    since: float

    @property
    def alive(self) -> bool:
        """Whether the process that wrote this still exists."""
        return self.birth == start_time_of(self.pid)


def runtime_directory() -> Path:
    """Return the directory of the register, and make it if need be.

    It is ``$XDG_RUNTIME_DIR/labhil``, or ``/tmp/labhil-UID`` without that variable.

    Raises:
        BusError: It cannot be made, or another user owns it, who could redirect this process.
    """
    base = os.environ.get("XDG_RUNTIME_DIR")
    path = Path(base) / "labhil" if base else Path(tempfile.gettempdir()) / f"labhil-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        owner = path.lstat().st_uid
    except OSError as error:
        raise BusError(f"{path}: expected a directory of ours, found {error}") from error
    if owner != os.getuid() or path.is_symlink():
        raise BusError(f"{path}: expected a directory of user {os.getuid()}, found one of user {owner}")
    return path


def start_time_of(pid: int) -> str:
    """Return the start time of a process as the kernel gives it; empty where there is no such process."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    state, *fields = stat.rpartition(")")[2].split()
    return "" if state == "Z" else fields[18]


@contextmanager
def register(kind: str, name: str, endpoint: str, devices: Sequence[str]) -> Iterator[None]:
    """Register this process for others as long as the context lasts.

    Args:
        kind: "run", "lab", "host" or "replay".
        name: Its name.
        endpoint: Where its bus is joined.
        devices: Its devices.
    """
    pid = os.getpid()
    entry = Registered(kind, name, endpoint, tuple(devices), pid, start_time_of(pid), time.time())
    path = runtime_directory() / f"{pid}-{next(_numbers)}.json"
    write_atomically(path, json.dumps(asdict(entry)))
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def store_key(endpoint: str, key: bytes) -> Path:
    """Store the key of the session at ``endpoint`` for the processes of this user; return its file."""
    pid = os.getpid()
    path = runtime_directory() / f"{pid}-{next(_numbers)}.key"
    text = json.dumps({"endpoint": endpoint, "key": key.hex(), "pid": pid, "birth": start_time_of(pid)})
    write_atomically(path, text)
    return path


def find_key(endpoint: str) -> bytes | None:
    """Return the key of the session at ``endpoint``; None where this user has none."""
    for path in runtime_directory().glob("*-*.key"):
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            data = parse_json(path.read_text(encoding="utf-8"))
            if start_time_of(int(data["pid"])) != data["birth"]:
                path.unlink(missing_ok=True)
            elif data["endpoint"] == endpoint and len(key := bytes.fromhex(data["key"])) == KEY_BYTES:
                return key
    return None


def write_atomically(path: Path, text: str) -> None:
    """Write a file that only this user can read, so that nobody reads a part of it; BusError on failure."""
    draft = path.with_suffix(f".{os.getpid()}.draft")
    try:
        with open(draft, "w", encoding="utf-8", opener=_open_private) as file:
            file.write(text)
        draft.replace(path)
    except OSError as error:
        raise BusError(f"{path}: expected to write a small file there, found {error}") from error


def _open_private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def registered_processes(kind: str | None = None) -> tuple[Registered, ...]:
    """Return the processes that can be reached, oldest first, and remove the files of dead ones.

    Args:
        kind: Only those of this kind.
    """
    entries = []
    for path in sorted(runtime_directory().glob("*-*.json")):
        entry = _read(path)
        if entry is None or not entry.alive:
            path.unlink(missing_ok=True)
        elif kind is None or entry.kind == kind:
            entries.append(entry)
    return tuple(sorted(entries, key=lambda entry: entry.since))


def find_run(connect: str | None = None, *, or_lab: bool = False) -> str:
    """Return where to control the run on this machine.

    Args:
        connect: An endpoint or the folder of a connection, which is checked and returned.
        or_lab: Where there is no run, return the endpoint of the lab that is served.

    Raises:
        UsageError: There is no run, or there are several.
    """
    if connect is not None:
        return check_joinable(connect)
    runs, labs = registered_processes("run"), registered_processes("lab")
    if labs and not runs and not or_lab:
        names = ", ".join(lab.name for lab in labs)
        raise UsageError(
            f"expected a run that is up, found only a served lab ({names}): `labhil control status` and "
            "`labhil estop` are for it, and Ctrl+C where it was started ends it"
        )
    runs = runs or labs
    if len(runs) == 1:
        return runs[0].endpoint
    if not runs:
        raise UsageError(f"expected a run that is up, found none in {runtime_directory()}")
    choice = ", ".join(f"{run.endpoint} ({run.name}, pid {run.pid})" for run in runs)
    raise UsageError(f"several runs are up; choose one with --connect: {choice}")


def check_loopback(endpoint: str) -> str:
    """Return ``endpoint``; UsageError unless it is on this machine."""
    if not LOOPBACK.match(endpoint):
        raise UsageError(
            f"expected an endpoint on this machine like tcp/127.0.0.1:40123, found {endpoint!r}; a lab on"
            " another machine is reached by the folder that `labhil security add` made there"
        )
    return endpoint


def is_endpoint(connect: str) -> bool:
    """Return whether this is an endpoint, and not the folder of a connection."""
    return ENDPOINT.match(connect) is not None


def check_joinable(connect: str) -> str:
    """Return ``connect``; UsageError for an endpoint on another machine, which needs a certificate."""
    return check_loopback(connect) if is_endpoint(connect) else connect


def reachable_buses() -> tuple[Registered, ...]:
    """Return one process of each bus on this machine: runs, labs and replays, and hosts without one."""
    entries = registered_processes()
    leaders = [entry for entry in entries if entry.kind != "host"]
    covered = {device for entry in leaders for device in entry.devices}
    alone = [entry for entry in entries if entry.kind == "host" and not covered.intersection(entry.devices)]
    return (*leaders, *alone)


def _read(path: Path) -> Registered | None:
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        data = parse_json(path.read_text(encoding="utf-8"))
        entry = Registered(**{**data, "devices": tuple(data["devices"])})
        return entry if LOOPBACK.match(entry.endpoint) else None
    return None
