"""A lab that is open to guests with certificates: the lab, its device, and its door, each its own process."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from labhil.security.authority import Authority
from labhil.security.roles import Role

PATIENCE = 90.0
LAB = """
[lab]
name = "open"
record = false
analyse = []
[devices.bench]
plugin = "ball_beam"
address = "twin"
twin = { seed = 1 }
"""
PEOPLE = {
    "vera": Role.VIEWER,
    "otto": Role.OPERATOR,
    "olga": Role.OPERATOR,
    "ada": Role.ADMIN,
    "rolf": Role.OPERATOR,
}
REVOKED = "rolf"


@dataclass(frozen=True, slots=True)
class OpenLab:
    """Where it is; ``runtime`` is the directory in which its processes find each other, and guests do not."""

    authority: Authority
    directory: Path
    runtime: Path
    stack: ExitStack

    def begin(self, who: str, *arguments: str) -> subprocess.Popen[bytes]:
        """Start a command on the lab's machine; it is ended with the lab."""
        file = self.stack.enter_context((self.directory / f"{who}.txt").open("w"))
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "labhil", *arguments],
            cwd=self.directory,
            env={**os.environ, "XDG_RUNTIME_DIR": str(self.runtime)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=file,
        )
        self.stack.callback(process.wait, PATIENCE)
        self.stack.callback(process.terminate)
        return process

    def folder(self, person: str) -> str:
        """What a person was given."""
        return str(self.authority.folder / "people" / person)

    @property
    def latch(self) -> Path:
        """Where the emergency stop stands on the lab's machine."""
        return self.runtime / "labhil" / "emergency_stop"

    def said(self, who: str) -> str:
        """What a process has written on its standard error so far."""
        return (self.directory / f"{who}.txt").read_text()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_for(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.1)


def labhil(*arguments: str, environment: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "labhil", *arguments]
    environment = {**os.environ, **(environment or {})}
    return subprocess.run(
        command, env=environment, text=True, capture_output=True, timeout=PATIENCE, check=False
    )


def make_people(folder: Path, port: int) -> Authority:
    """A folder of certificates, with somebody of each role, and one who was revoked."""
    authority = Authority.create(folder, ["127.0.0.1", "localhost"], port)
    for name, role in PEOPLE.items():
        authority.add(name, role, 30)
    authority.revoke(REVOKED)
    return Authority.load(folder)


@contextmanager
def open_lab(directory: Path) -> Iterator[OpenLab]:
    """Serve a simulated bench to guests; every process has ended at the end."""
    runtime = directory / "runtime"
    runtime.mkdir(mode=0o700)
    (directory / "lab.toml").write_text(LAB)
    with ExitStack() as stack:
        lab = OpenLab(make_people(directory / "keys", free_port()), directory, runtime, stack)
        lab.begin("lab", "serve", "--config", "lab.toml")
        wait_for(lambda: "bench: ball_beam at" in lab.said("lab"), "the bench")
        lab.begin("door", "security", "serve", str(lab.authority.folder), "--listen", "127.0.0.1")
        wait_for(lambda: "open at" in lab.said("door"), "the door")
        yield lab
