"""Readers of foreign formats in a separate process, so that a malicious file cannot crash this one.

Their libraries parse untrusted files in C. The process has limits of memory and processor time, and returns
plain data (:mod:`labhil.recording.formats.transfer`). It stays for further files until it has been idle for a
while, or this process exits. ``reader_process.py`` is its program.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labhil import errors
from labhil.errors import LabhilError, TableError
from labhil.extras import require
from labhil.recording.formats.columns import Columns
from labhil.recording.formats.lerobot import is_dataset
from labhil.recording.formats.transfer import HEAD, parse_answer, unpack_columns
from labhil.rig_sections import Table

PACKAGES = {
    "hdf5": ("h5py", "a MAT file of version 7.3 (HDF5)"),
    "parquet": ("pyarrow", "a Parquet file"),
    "lerobot": ("pyarrow", "a LeRobot dataset"),
    "workbook": ("openpyxl", "a workbook (XLSX)"),
    "bag": ("rosbags", "a ROS 2 bag"),
}
"""Optional package that reads each kind of file, and the name of such a file in messages."""


@dataclass(frozen=True, slots=True)
class ReaderLimits:
    """Limits of the reader's process.

    Attributes:
        start_seconds: longest start of the process, s; it imports numpy on a machine that may be busy.
        cpu_seconds: processor time for any file, s.
        cpu_seconds_per_byte: further processor time, s/byte; the slowest reader (XLSX) takes 2e-6.
        wall_factor: wall time per processor time, on a machine with other work.
        memory: memory for libraries and 16 MiB of content, bytes.
        memory_per_byte: further memory per byte of the file; a cell of a workbook takes about 8 bytes in the
            file and 60 as a Python object.
    """

    start_seconds: float = 60.0
    cpu_seconds: float = 4.0
    cpu_seconds_per_byte: float = 20e-6
    wall_factor: float = 4.0
    memory: int = 512 << 20
    memory_per_byte: int = 64


def read_isolated(
    kind: str, path: Path, table: Table, wanted: Sequence[str], limits: ReaderLimits | None = None
) -> Columns:
    """Read a foreign file in a separate process.

    Args:
        kind: the reader: ``mat``, ``hdf5``, ``parquet``, ``lerobot``, ``workbook``, ``bag``, ``npz`` or
            ``mcap``.
        path: the file, or the folder of a bag or dataset.
        table: section ``[table]`` of the rig file.
        wanted: names of columns in the rig file.
        limits: limits of time and memory; None for the defaults.

    Returns:
        The table.

    Raises:
        TableError: The file cannot be read, crashes its reader, or exceeds the time or memory for its size.
        MissingExtraError: The package that reads it is not installed.
    """
    _require_package(kind, path)
    size, limits = _size(path), limits or ReaderLimits()
    request = {
        "kind": kind,
        "path": str(path),
        "folder": str(Path.cwd()),
        "table": table.model_dump(mode="json"),
        "wanted": list(wanted),
        "cpu_seconds": limits.cpu_seconds + limits.cpu_seconds_per_byte * size,
        "memory": limits.memory + limits.memory_per_byte * size,
    }
    with _LOCK:
        answer = _PROCESS.ask(request, path, limits)
    if "error" in answer:
        raise _restore_error(answer["error"], answer["text"])
    try:
        columns = unpack_columns(answer["columns"], answer["arrays"])
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise TableError(f"{path}: its reader returned no table: {error!r:.200}") from error
    if not isinstance(columns, Columns):
        raise TableError(f"{path}: its reader returned no table")
    return columns


def _require_package(kind: str, path: Path) -> None:
    """Raise MissingExtraError if the package is not installed, before a process starts."""
    if kind in PACKAGES:
        package, what = PACKAGES[kind]
        require(package, f"{path}: {what}")


class _ReaderProcess:
    """The reader's process, started when there is a file to read."""

    def __init__(self) -> None:
        self._child: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def ask(self, request: dict[str, Any], path: Path, limits: ReaderLimits) -> dict[str, Any]:
        """Send a request and return the answer; TableError if the process ends without one."""
        child = self._running_child(limits.start_seconds)
        assert child.stdin is not None
        wall = limits.wall_factor * request["cpu_seconds"]
        watch = threading.Timer(wall, child.kill)
        watch.start()
        try:
            child.stdin.write(json.dumps(request).encode() + b"\n")
            child.stdin.flush()
            return self._answer(child, request["memory"])
        except (EOFError, OSError, ValueError) as error:
            timed_out = not watch.is_alive()
            self.stop()
            cause = _exit_cause(child.returncode, request, wall, timed_out)
            raise TableError(f"{path}: cannot be read: {cause}") from error
        finally:
            watch.cancel()

    def _answer(self, child: subprocess.Popen[bytes], most: int) -> dict[str, Any]:
        length, payload = HEAD.unpack(_read_exactly(child, HEAD.size))
        if length + payload > most:
            raise ValueError("the answer is longer than what may be read")
        answer = parse_answer(_read_exactly(child, length))
        answer["arrays"] = _read_exactly(child, payload)
        return answer

    def _running_child(self, start_seconds: float) -> subprocess.Popen[bytes]:
        child = self._child
        # a forked process shares the pipes of its parent, and needs its own reader
        if child is not None and self._owner == os.getpid() and child.poll() is None:
            return child
        if child is not None and self._owner == os.getpid():
            self.stop()
        child = subprocess.Popen(
            [sys.executable, "-P", "-m", "labhil.recording.formats.reader_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            start_new_session=True,  # Ctrl+C reaches only us
        )
        watch = threading.Timer(start_seconds, child.kill)
        watch.start()
        try:
            _read_exactly(child, 1)
        except EOFError as error:
            raise TableError("the process that reads files did not start; try again") from error
        finally:
            watch.cancel()
        self._child, self._owner = child, os.getpid()
        return child

    def stop(self) -> None:
        """End the process unless a parent process owns it."""
        child, self._child = self._child, None
        if child is None or self._owner != os.getpid():
            return
        child.kill()
        child.wait()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


_LOCK = threading.Lock()
_PROCESS = _ReaderProcess()
atexit.register(_PROCESS.stop)


def _read_exactly(child: subprocess.Popen[bytes], count: int) -> bytes:
    assert child.stdout is not None
    data = child.stdout.read(count)
    if len(data) < count:
        raise EOFError
    return data


def _size(path: Path) -> int:
    """Size of a file, or of the files in a folder, bytes; of a LeRobot dataset that of its largest file."""
    try:
        if is_dataset(path):
            return max((file.stat().st_size for file in (path / "data").rglob("*.parquet")), default=0)
        if path.is_dir():
            return sum(inner.stat().st_size for inner in path.iterdir() if inner.is_file())
        return path.stat().st_size
    except OSError as error:
        raise TableError(f"{path}: cannot be read: {error.strerror}") from error


def _exit_cause(status: int | None, request: dict[str, Any], wall: float, timed_out: bool) -> str:
    """Why the process ended, for messages."""
    if timed_out:
        return f"its reader took longer than {wall:.0f} s"
    if status == -signal.SIGXCPU:
        return f"its reader took more than {request['cpu_seconds']:.0f} s of processor time"
    if status is not None and status < 0:
        try:
            name = signal.Signals(-status).name
        except ValueError:
            name = str(-status)
        return f"its reader crashed ({name})"
    return "its reader ended without an answer"


def _restore_error(name: str, text: str) -> LabhilError:
    """The error of the reader, with its message."""
    kind = getattr(errors, name, None)
    if not (isinstance(kind, type) and issubclass(kind, LabhilError)):
        return TableError(text)
    error = kind.__new__(kind)  # without __init__, whose parameters differ between errors
    error.args = (text,)
    return error
