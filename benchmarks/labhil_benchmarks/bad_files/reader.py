"""Runs commands on bad files in a process of its own, which is replaced where a command crashes it."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

PATIENCE = 40.0
"""Seconds until a command that does not end is ended: twice what it may take."""
START = 120.0
COMMANDS = 400
"""Commands of one process: what many of them leave behind is not held against one."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a command did: exit status (below 0 a signal), s, bytes of memory, and what it printed."""

    status: int
    seconds: float
    memory: int
    out: str
    err: str
    traceback: str = ""


class Reader:
    """A process that runs commands one after another.

    Args:
        folder: Where it keeps what commands print and what they leave in folders for temporary files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._child: subprocess.Popen[bytes] | None = None
        self._left = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def run(self, command: tuple[str, ...], folder: Path) -> Outcome:
        """Run a command in a folder."""
        child = self._start()
        self._left -= 1
        out, err = self._folder / "stdout", self._folder / "stderr"
        request = {"command": command, "folder": str(folder), "stdout": str(out), "stderr": str(err)}
        assert child.stdin is not None
        child.stdin.write(json.dumps(request).encode() + b"\n")
        child.stdin.flush()
        answer = self._answer(child, PATIENCE)
        texts = [path.read_bytes().decode("utf-8", "replace") for path in (out, err)]
        if answer is None:
            child.poll()
            status = child.returncode if child.returncode is not None else -signal.SIGKILL
            seconds = PATIENCE if child.returncode is None else 0.0
            self._stop()
            return Outcome(status, seconds, 0, texts[0], texts[1])
        return Outcome(
            answer["status"], answer["seconds"], answer["memory"], texts[0], texts[1], answer["traceback"]
        )

    def _start(self) -> subprocess.Popen[bytes]:
        if self._child is not None and self._left <= 0:
            self._stop()
        if self._child is None:
            rest = {name: str(self._folder) for name in ("XDG_RUNTIME_DIR", "TMPDIR")}
            path = os.pathsep.join(entry for entry in sys.path if entry)
            self._child = subprocess.Popen(
                [sys.executable, "-P", "-m", "labhil_benchmarks.bad_files.process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
                env={**os.environ, **rest, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "COLUMNS": "200"},
            )
            self._left = COMMANDS
            if self._answer(self._child, START) is None:
                raise TimeoutError("the process that runs commands did not start")
        return self._child

    @staticmethod
    def _answer(child: subprocess.Popen[bytes], patience: float) -> dict[str, Any] | None:
        """A line of its answers; None where it ended or did not come."""
        assert child.stdout is not None
        if not select.select([child.stdout], [], [], patience)[0]:
            return None
        line = child.stdout.readline()
        if not line:
            child.wait(10)
            return None
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _stop(self) -> None:
        child, self._child = self._child, None
        if child is None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)  # with the readers that it has started
        child.wait()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                pipe.close()
