"""A bench to test on: the simulated device on its wire, its host, and a seat on their bus."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from patient_labhil import PATIENT_WATCHDOG

from labhil.bus.ask import ask
from labhil.bus.keys import ALL_STREAMS, command_key, event_key, setpoint_key
from labhil.bus.publish import publish_command
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import subscribe
from labhil.experiment.device_sections import TwinSection
from labhil.experiment.twins import start_twin
from labhil.rig_sections import Limit
from labhil.service.hosts import ConnectedDevice, HostProcess
from labhil.service.messages import HostConfig, Setpoint

DEVICE = "bench"
LIMITS = {"servo_angle": Limit(min=-1.0, max=1.0, rate=5.0), "ball_position": Limit(min=-0.2, max=0.2)}
PATIENCE = 60.0


class Bench:
    """A running host with its twin; what it announces is collected in ``events``."""

    def __init__(
        self, bus: Bus, host: HostProcess, device: ConnectedDevice, events: list[dict[str, Any]]
    ) -> None:
        self.bus, self.host, self.device, self.events = bus, host, device, events
        self.token = ""

    def ask(self, name: str, **payload: Any) -> dict[str, Any]:
        # who is known to be there is found by the bus in time, and a busy machine takes seconds for it
        return ask(self.bus, command_key(DEVICE, name), payload, patience=PATIENCE)

    def take_lease(self, holder: str = "test") -> str:
        self.token = str(self.ask("lease", action="take", holder=holder)["token"])
        return self.token

    def set(self, angle: float, token: str | None = None, age: float = 0.0) -> dict[str, Any]:
        return self.ask("set", **self.setpoint(angle, token, age).to_json())

    def put(self, angle: float) -> None:
        publish_command(self.bus, setpoint_key(DEVICE), self.setpoint(angle).to_bytes())

    def setpoint(self, angle: float, token: str | None = None, age: float = 0.0) -> Setpoint:
        t_ns = time.time_ns() - round(age * 1e9)
        return Setpoint(self.token if token is None else token, t_ns, {"servo_angle": angle})

    def wait_for_event(self, kind: str) -> dict[str, Any]:
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            for event in self.events:
                if event["kind"] == kind:
                    return event
            time.sleep(0.01)
        alive = psutil.pid_exists(self.host.pid)
        raise AssertionError(
            f"no event {kind!r} among {self.events}; host alive: {alive}, failure: {self.host.failure()!r}"
        )


@contextmanager
def running_twin(directory: Path, plugin: str = "ball_beam", **twin: Any) -> Iterator[str]:
    """Start a twin that runs at twice the speed, and give its address."""
    section = TwinSection(**{"speed": 2.0, "seed": 1, **twin})
    process, address = start_twin(DEVICE, plugin, section, directory / "twin.json", lambda: False)
    with process:
        yield address


@contextmanager
def running_host(
    address: str, limits: dict[str, Limit], watchdog: float = PATIENT_WATCHDOG, plugin: str = "ball_beam"
) -> Iterator[Bench]:
    """Start a host, and a bus for it; everything is stopped at the end."""
    with ExitStack() as stack:
        bus = stack.enter_context(open_bus())
        events: list[dict[str, Any]] = []

        def collect(key: str, payloads: list[bytes]) -> None:
            if key == event_key(DEVICE):
                events.extend(json.loads(payload) for payload in payloads)

        stack.enter_context(subscribe(bus, ALL_STREAMS, collect))
        host = HostProcess(HostConfig(DEVICE, plugin, address, limits, bus.endpoint, watchdog))
        stack.callback(host.stop)
        yield Bench(bus, host, host.wait_connected(), events)


@pytest.fixture(scope="session")
def twin_address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Return where a twin without faults is; it boots anew for each client."""
    with running_twin(tmp_path_factory.mktemp("twin")) as address:
        yield address


@pytest.fixture
def start_bench(tmp_path: Path, twin_address: str) -> Iterator[Callable[..., Bench]]:
    """Return what starts a bench for this test: ``start_bench(limits, set={…})``, with a twin of its own."""
    with ExitStack() as stack:

        def start(
            limits: dict[str, Limit] | None = None,
            watchdog: float = PATIENT_WATCHDOG,
            plugin: str = "ball_beam",
            **twin: Any,
        ) -> Bench:
            address = stack.enter_context(running_twin(tmp_path, plugin, **twin)) if twin else twin_address
            limits = LIMITS if limits is None else limits
            return stack.enter_context(running_host(address, limits, watchdog, plugin))

        yield start


@pytest.fixture
def bench(start_bench: Callable[..., Bench]) -> Bench:
    """Return a bench with limits, idle."""
    return start_bench()
