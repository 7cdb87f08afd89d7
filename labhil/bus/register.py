"""Which buses run on this machine: a small file for each process that others may want to reach.

A process that listens writes ``PID-NUMBER.json`` into a directory that only its user can read and takes it
away at the end; what a killed process left behind is swept by whoever looks next. Beside it stands
``PID-NUMBER.key`` with the key of the session, which commands are authenticated with: whoever may read that
file may command. Loopback only.
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
    """A process that can be reached at ``endpoint``: a ``run``, with all its devices, or one ``host``.

    ``birth`` tells a process from a later one of the same ``pid``; ``since`` is Unix time, s.
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
        return self.birth == birth_of(self.pid)


def runtime_directory() -> Path:
    """Return our directory, made if need be: ``$XDG_RUNTIME_DIR/labhil``, else ``/tmp/labhil-UID``.

    BusError where somebody else owns it, who could point us anywhere.
    """
    given = os.environ.get("XDG_RUNTIME_DIR")
    path = Path(given) / "labhil" if given else Path(tempfile.gettempdir()) / f"labhil-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        owner = path.lstat().st_uid
    except OSError as error:
        raise BusError(f"{path}: expected a directory of ours, found {error}") from error
    if owner != os.getuid() or path.is_symlink():
        raise BusError(f"{path}: expected a directory of user {os.getuid()}, found one of user {owner}")
    return path


def birth_of(pid: int) -> str:
    """Return when a process began, in the kernel's words; empty when there is none of that number."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    state, *fields = stat.rpartition(")")[2].split()
    return "" if state == "Z" else fields[18]


@contextmanager
def registered(kind: str, name: str, endpoint: str, devices: Sequence[str]) -> Iterator[None]:
    """Let others find this process, as long as the context lasts."""
    pid = os.getpid()
    entry = Registered(kind, name, endpoint, tuple(devices), pid, birth_of(pid), time.time())
    path = runtime_directory() / f"{pid}-{next(_numbers)}.json"
    write_whole(path, json.dumps(asdict(entry)))
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def keep_key(endpoint: str, key: bytes) -> Path:
    """Leave the key of the session that is reached at ``endpoint`` for this user's processes; its file."""
    pid = os.getpid()
    path = runtime_directory() / f"{pid}-{next(_numbers)}.key"
    text = json.dumps({"endpoint": endpoint, "key": key.hex(), "pid": pid, "birth": birth_of(pid)})
    write_whole(path, text)
    return path


def key_of(endpoint: str) -> bytes | None:
    """Return the key of the session that is reached at ``endpoint``; None where this user has none."""
    for path in runtime_directory().glob("*-*.key"):
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            data = parse_json(path.read_text(encoding="utf-8"))
            if birth_of(int(data["pid"])) != data["birth"]:
                path.unlink(missing_ok=True)
            elif data["endpoint"] == endpoint and len(key := bytes.fromhex(data["key"])) == KEY_BYTES:
                return key
    return None


def write_whole(path: Path, text: str) -> None:
    """Write a file of this user's alone so that nobody ever reads half of it; BusError where that fails."""
    draft = path.with_suffix(f".{os.getpid()}.draft")
    try:
        with open(draft, "w", encoding="utf-8", opener=_for_us_alone) as file:
            file.write(text)
        draft.replace(path)
    except OSError as error:
        raise BusError(f"{path}: expected to write a small file there, found {error}") from error


def _for_us_alone(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def running(kind: str | None = None) -> tuple[Registered, ...]:
    """Return who can be reached, oldest first; what dead processes left behind is swept."""
    entries = []
    for path in sorted(runtime_directory().glob("*-*.json")):
        entry = _read(path)
        if entry is None or not entry.alive:
            path.unlink(missing_ok=True)
        elif kind is None or entry.kind == kind:
            entries.append(entry)
    return tuple(sorted(entries, key=lambda entry: entry.since))


def find_run(connect: str | None = None, *, or_lab: bool = False) -> str:
    """Return the endpoint of the one run that is up, or ``connect`` if that is given and may be joined.

    With ``or_lab`` that of the one lab that is served, where there is no run. UsageError when there is none,
    or several to choose from.
    """
    if connect is not None:
        return check_joinable(connect)
    runs, labs = running("run"), running("lab")
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
    """Return ``endpoint``; UsageError unless it is a place on this machine."""
    if not LOOPBACK.match(endpoint):
        raise UsageError(
            f"expected an endpoint on this machine like tcp/127.0.0.1:40123, found {endpoint!r}; a lab on"
            " another machine is reached by the folder that `labhil security add` made there"
        )
    return endpoint


def is_endpoint(connect: str) -> bool:
    """Whether this is an endpoint, and not the folder of a connection."""
    return ENDPOINT.match(connect) is not None


def check_joinable(connect: str) -> str:
    """Return ``connect``; UsageError for an endpoint beyond this machine, where a certificate is needed."""
    return check_loopback(connect) if is_endpoint(connect) else connect


def reachable_buses() -> tuple[Registered, ...]:
    """Return one process of each bus on this machine: every leader, and hosts without one."""
    entries = running()
    leaders = [entry for entry in entries if entry.kind != "host"]
    led = {device for entry in leaders for device in entry.devices}
    leaderless = [entry for entry in entries if entry.kind == "host" and not led.intersection(entry.devices)]
    return (*leaders, *leaderless)


def _read(path: Path) -> Registered | None:
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        data = parse_json(path.read_text(encoding="utf-8"))
        entry = Registered(**{**data, "devices": tuple(data["devices"])})
        return entry if LOOPBACK.match(entry.endpoint) else None
    return None
