"""A twin in a separate process, for tests of programs that use a robot.

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
    """A running twin at the address ``host``."""

    def __init__(self, host: str, process: subprocess.Popen[str]) -> None:
        self.host = host
        self._process = process

    def tell(self, line: str) -> None:
        """Inject a fault or set an input: ``protective stop``, ``stall 0.5``, ``digital_in 3 1``, …."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()


@contextmanager
def running_twin(
    host: str = "127.0.0.1", series: str = "e", settings: Mapping[str, float] | None = None
) -> Iterator[TwinProcess]:
    """Start a twin, and end it after the ``with``.

    Args:
        host: An address of this machine.
        series: The series or version of its controller.
        settings: Settings of ``labhil twin ur5 --list``.

    Raises:
        RuntimeError: It does not start; the message has its error output.
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
