"""A twin of a UR5 in a process of its own, and clients beside it."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.service.child import Child
from labhil_sim_ur5.codec import Command, PackageParser, package

CALLS = Path(__file__).with_name("ur5_calls.py")
START = 90.0
"""s: the first start compiles the arm."""


def address(number: int) -> str:
    """An address of this machine that other test runs on it do not use."""
    pid = os.getpid()
    return f"127.{1 + pid % 250}.{1 + pid // 250 % 250}.{number}"


@contextmanager
def running_twin(host: str, *arguments: str) -> Iterator[Child]:
    """Start a twin at an address and stop it afterwards."""
    command = [*PATIENT_LABHIL, "twin", "ur5", "--host", host, *arguments]
    with Child("the twin", command) as twin:
        said = twin.line(START)
        assert said == host, (said, twin.last_error())
        yield twin


def call(host: str, *checks: str, timeout: float = 60.0) -> None:
    """Run checks of the client in a process of its own; fail with what went wrong."""
    done = subprocess.run(
        [sys.executable, CALLS, host, *checks], capture_output=True, text=True, timeout=timeout, check=False
    )
    bad = [line for line in done.stdout.splitlines() if not line.endswith(": ok")]
    assert done.returncode == 0, "\n".join([*bad, f"exit status {done.returncode}", done.stderr[-2000:]])


class RawClient:
    """A client of the RTDE port that knows no library: bytes out, packages in."""

    def __init__(self, host: str) -> None:
        self._socket = socket.create_connection((host, 30004), timeout=10.0)
        self._framer = PackageParser()
        self._packages: list[tuple[int, bytes]] = []

    def ask(self, command: int, payload: bytes = b"") -> bytes:
        """Send a package and return the payload of its answer."""
        self._socket.sendall(package(command, payload))
        while True:
            found, answer = self.next()
            if found == command:
                return answer

    def send(self, data: bytes) -> None:
        """Send bytes as they are."""
        self._socket.sendall(data)

    def next(self) -> tuple[int, bytes]:
        """Return the next package; ConnectionError at the end of the connection."""
        while not self._packages:
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionError("the controller closed the connection")
            self._packages += self._framer.packages(data)
        return self._packages.pop(0)

    def stream(self, names: Sequence[str], frequency: float) -> str:
        """Ask for variables and start; return their types."""
        answer = self.ask(Command.OUTPUTS, struct.pack(">d", frequency) + ",".join(names).encode())
        assert answer[0] == 1, answer
        assert self.ask(Command.START) == b"\x01"
        return answer[1:].decode()

    def doubles(self) -> tuple[float, ...]:
        """Return the next data package of a stream of doubles."""
        while True:
            command, payload = self.next()
            if command == Command.DATA:
                return struct.unpack(f">{len(payload) // 8}d", payload[1:])

    def close(self) -> None:
        """Let go."""
        self._socket.close()

    def __enter__(self) -> RawClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
