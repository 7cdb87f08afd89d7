"""Processes that are killed, what they leave running, and who listens on their bus meanwhile."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil

from labhil.bus.ask import ask
from labhil.bus.keys import ALL_STREAMS, command_key, setpoint_key
from labhil.bus.publish import publish_command
from labhil.bus.register import registered_processes
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import subscribe
from labhil.codec import stamps_of
from labhil.documents import parse_json
from labhil.errors import BusError
from labhil.host_clock import unix_ns
from labhil.service.messages import Setpoint
from measure_safety import PATIENCE, Relay

LEAVING = 12.0
"""s that what belonged to a killed process may take to end before it counts as left."""


class Listener:
    """What is published on a bus: the payloads of every stream by number, and the events of the run."""

    def __init__(self, endpoint: str, stack: ExitStack) -> None:
        self.streams: dict[str, dict[int, bytes]] = {}
        self.events: list[dict[str, Any]] = []
        self.bus = stack.enter_context(open_bus(endpoint))
        stack.enter_context(subscribe(self.bus, ALL_STREAMS, self._take))

    def _take(self, key: str, payloads: list[bytes]) -> None:
        _, device, stream = key.split("/")
        if stream == "event":
            self.events += [parse_json(payload.decode()) | {"device": device} for payload in payloads]
        elif stream != "setpoint":
            numbers = stamps_of(payloads)[:, 0].tolist()
            self.streams.setdefault(f"/{device}/{stream}", {}).update(zip(numbers, payloads, strict=True))

    def began_ns(self) -> int | None:
        """When the run began to keep its samples, Unix time; None where it has not yet."""
        return next((event["t_ns"] for event in self.events if event.get("kind") == "running"), None)


class Commander:
    """Holds the lease of a served device and commands it a hundred times a second."""

    def __init__(self, bus: Bus) -> None:
        answer = ask(bus, command_key("bench", "lease"), {"holder": "meter"}, 2.0, patience=20.0)
        self._bus, self._token, self._over = bus, str(answer["token"]), threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        level = 0.3
        while not self._over.wait(0.01):
            level = 1.0 - level
            setpoint = Setpoint(self._token, time.time_ns(), {"coil_current_command": level})
            try:
                publish_command(self._bus, setpoint_key("bench"), setpoint.to_bytes())
            except BusError:  # the bus is closed when the trial is over
                return

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@contextmanager
def process(command: list[str], folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A process in a folder; ended in order, or killed, if it is still there."""
    with (folder / "said.txt").open("w") as log:
        started = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.PIPE, stdout=log, stderr=log, text=True
        )
    try:
        yield started
    finally:
        if started.poll() is None:
            started.send_signal(signal.SIGINT)
        try:
            started.wait(20)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()
        assert started.stdin is not None
        started.stdin.close()


def endpoint_of(started: subprocess.Popen[str], kind: str) -> str:
    """Where a run or a lab can be reached, as soon as it can."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        for entry in registered_processes(kind):
            if entry.pid == started.pid:
                return entry.endpoint
        if started.poll() is not None:
            raise ValueError(f"the {kind} ended before it was up")
        time.sleep(0.005)
    raise TimeoutError(f"the {kind} did not come up")


def wait_until(condition: Callable[[], bool], what: str, patience: float = 120.0) -> None:
    """ValueError where it does not come about within ``patience`` s: a busy machine starts a process in a
    minute."""
    deadline = time.monotonic() + patience
    while not condition():
        if time.monotonic() > deadline:
            raise ValueError(f"waited in vain until {what}")
        time.sleep(0.005)


def kill(victim: int, family: list[psutil.Process], relay: Relay | None, outcome: dict[str, Any]) -> int:
    """Kill a process; note when the device is safe and its ``family`` gone. Returns the moment, Unix ns."""
    active = relay is not None and not relay.safe
    began, killed_ns = time.monotonic(), unix_ns()
    os.kill(victim, signal.SIGKILL)
    if relay is not None and active:
        outcome["safe_ms"] = round(1e3 * (relay.wait(safe=True, after=began) - began), 1)
    while (
        survivors := [member for member in family if is_at_work(member)]
    ) and time.monotonic() < began + LEAVING:
        time.sleep(0.02)
    outcome["all_gone_ms"] = round(1e3 * (time.monotonic() - began), 1) if family and not survivors else None
    outcome["processes_left"] = [" ".join(member.cmdline())[-80:] for member in survivors]
    for member in survivors:
        member.kill()
    return killed_ns


def is_at_work(member: psutil.Process) -> bool:
    """Whether a process is there, and no zombie that nobody has waited for."""
    try:
        return member.is_running() and member.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def family_of(pid: int) -> list[psutil.Process]:
    return psutil.Process(pid).children(recursive=True)


def child_of(pid: int, word: str) -> int:
    """The child process that has this word in its command line."""
    for child in family_of(pid):
        if word in child.cmdline():
            return child.pid
    raise ValueError(f"no process with {word!r} among the children")
