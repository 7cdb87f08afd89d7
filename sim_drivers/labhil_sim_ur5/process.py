"""A twin in a process of its own, for tests of programs that use a robot.

It has to be another process: the client's constructors hold Python's lock while they wait for the robot.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

STOP_TIMEOUT = 5.0


class TwinProcess:
    """A running twin: where it is, and what to tell it."""

    def __init__(self, host: str, process: subprocess.Popen[str]) -> None:
        self.host = host
        self._process = process

    def tell(self, line: str) -> None:
        """Have a fault, or an input: ``protective stop``, ``stall 0.5``, ``digital_in 3 1``, …."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()


@contextmanager
def running_twin(
    host: str = "127.0.0.1", series: str = "e", settings: Mapping[str, float] | None = None
) -> Iterator[TwinProcess]:
    """Start a twin at an address of this machine; it listens inside the ``with`` and is gone after it.

    ``settings`` are those of ``labhil twin ur5 --list``. Raises RuntimeError with the twin's own words when
    it does not start.
    """
    command = [sys.executable, "-m", "labhil", "twin", "ur5", "--host", host, "--series", series]
    for name, value in (settings or {}).items():
        command += ["--set", f"{name}={value!r}"]
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
        )
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            if process.stdout.readline().strip() != host:
                errors.seek(0)
                raise RuntimeError(f"the twin did not start: {errors.read().strip()}")
            yield TwinProcess(host, process)
        finally:
            process.stdin.close()
            try:
                process.wait(STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()
