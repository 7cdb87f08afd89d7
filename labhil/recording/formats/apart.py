"""Readers of others' formats, in a process of their own: a file that crashes one does not take us along.

The libraries behind them parse in C what a stranger wrote. The process has bounds on memory and on processor
time; what it read comes back as plain data (:mod:`labhil.recording.formats.transfer`). It stays for the next
file and ends when there has been none for a while, or when we end.
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
from pathlib import Path
from typing import Any

from labhil import errors
from labhil.errors import LabhilError, TableError
from labhil.extras import require
from labhil.recording.formats.columns import Columns
from labhil.recording.formats.lerobot import is_dataset
from labhil.recording.formats.transfer import HEAD, parse_answer, unpack_columns
from labhil.rig_sections import Table

START_SECONDS = 60.0
"""How long the process may take until it is ready: it imports numpy, on a machine that may be busy."""

CPU_SECONDS = 4.0
CPU_SECONDS_PER_BYTE = 20e-6
"""Processor time for a file: a start, and 20 s a megabyte. The slowest reader (XLSX) takes 2 s a megabyte."""

WALL_FACTOR = 4.0
"""Wall time for a second of processor time, on a machine that does other things beside."""

MEMORY = 512 << 20
MEMORY_PER_BYTE = 64
"""Bytes of memory for a file: libraries and 16 MiB of content, and 64 for a byte of it. A cell of a workbook
takes about 8 bytes in the file and 60 as a Python object."""


PACKAGES = {
    "hdf5": ("h5py", "a MAT file of version 7.3 (HDF5)"),
    "parquet": ("pyarrow", "a Parquet file"),
    "lerobot": ("pyarrow", "a LeRobot dataset"),
    "workbook": ("openpyxl", "a workbook (XLSX)"),
    "bag": ("rosbags", "a ROS 2 bag"),
}
"""What reads a kind of file and need not be installed, and how a message names such a file."""


def read_apart(kind: str, path: Path, table: Table, wanted: Sequence[str]) -> Columns:
    """Read a file of others in a process of its own.

    Args:
        kind: Which reader: ``mat``, ``hdf5``, ``parquet``, ``workbook`` or ``bag``.
        path: The file, or the folder of a bag.
        table: How the rig file says that tables are read.
        wanted: The column names that the rig file asks for.

    Raises:
        TableError: It cannot be read, crashes its reader, or takes more time or memory than its size allows.
        MissingExtraError: What reads it is not installed.
    """
    _require_package(kind, path)
    size = _size(path)
    request = {
        "kind": kind,
        "path": str(path),
        "folder": str(Path.cwd()),
        "table": table.model_dump(mode="json"),
        "wanted": list(wanted),
        "cpu_seconds": CPU_SECONDS + CPU_SECONDS_PER_BYTE * size,
        "memory": MEMORY + MEMORY_PER_BYTE * size,
    }
    with _LOCK:
        answer = _PROCESS.ask(request, path)
    if "error" in answer:
        raise _error(answer["error"], answer["text"])
    try:
        columns = unpack_columns(answer["columns"], answer["arrays"])
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise TableError(f"{path}: its reader returned no table: {error!r:.200}") from error
    if not isinstance(columns, Columns):
        raise TableError(f"{path}: its reader returned no table")
    return columns


def _require_package(kind: str, path: Path) -> None:
    """MissingExtraError where the package is not installed, before a process is started for it."""
    if kind in PACKAGES:
        package, what = PACKAGES[kind]
        require(package, f"{path}: {what}")


class _Process:
    """The process that reads, started when there is something to read."""

    def __init__(self) -> None:
        self._child: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def ask(self, request: dict[str, Any], path: Path) -> dict[str, Any]:
        """Send a request and return the answer; TableError where the process ends over it."""
        child = self._running_child()
        assert child.stdin is not None
        wall = WALL_FACTOR * request["cpu_seconds"]
        watch = threading.Timer(wall, child.kill)
        watch.start()
        try:
            child.stdin.write(json.dumps(request).encode() + b"\n")
            child.stdin.flush()
            return self._answer(child, request["memory"])
        except (EOFError, OSError, ValueError) as error:
            timed_out = not watch.is_alive()
            self.stop()
            cause = _end(child.returncode, request, wall, timed_out)
            raise TableError(f"{path}: cannot be read: {cause}") from error
        finally:
            watch.cancel()

    def _answer(self, child: subprocess.Popen[bytes], most: int) -> dict[str, Any]:
        length, payload = HEAD.unpack(_exactly(child, HEAD.size))
        if length + payload > most:
            raise ValueError("the answer is longer than what may be read")
        answer = parse_answer(_exactly(child, length))
        answer["arrays"] = _exactly(child, payload)
        return answer

    def _running_child(self) -> subprocess.Popen[bytes]:
        child = self._child
        # a forked process shares the pipes of its parent: it needs a reader of its own
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
        watch = threading.Timer(START_SECONDS, child.kill)
        watch.start()
        try:
            _exactly(child, 1)
        except EOFError as error:
            raise TableError("the process that reads files did not start; try again") from error
        finally:
            watch.cancel()
        self._child, self._owner = child, os.getpid()
        return child

    def stop(self) -> None:
        """End the process, if it is ours."""
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
_PROCESS = _Process()
atexit.register(_PROCESS.stop)


def _exactly(child: subprocess.Popen[bytes], count: int) -> bytes:
    assert child.stdout is not None
    data = child.stdout.read(count)
    if len(data) < count:
        raise EOFError
    return data


def _size(path: Path) -> int:
    """Bytes of a file, or of the files in a folder; of a dataset's files those of the largest."""
    try:
        if is_dataset(path):
            return max((file.stat().st_size for file in (path / "data").rglob("*.parquet")), default=0)
        if path.is_dir():
            return sum(inner.stat().st_size for inner in path.iterdir() if inner.is_file())
        return path.stat().st_size
    except OSError as error:
        raise TableError(f"{path}: cannot be read: {error.strerror}") from error


def _end(status: int | None, request: dict[str, Any], wall: float, timed_out: bool) -> str:
    """Why the process ended, for a message."""
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


def _error(name: str, text: str) -> LabhilError:
    """The error that the reader raised, with its own message."""
    kind = getattr(errors, name, None)
    if not (isinstance(kind, type) and issubclass(kind, LabhilError)):
        return TableError(text)
    error = kind.__new__(kind)  # some have constructors of their own; the message is all that matters here
    error.args = (text,)
    return error
