"""One device at hand, from Python: samples in, commands out, under its host's limits and watchdog."""

from __future__ import annotations

import tempfile
import threading
import time
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from labhil.bus.ask import ask
from labhil.bus.authentication import Refusals
from labhil.bus.keys import command_key, stream_key
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import subscribe
from labhil.codec import Codec
from labhil.driver import DriverSpec
from labhil.errors import (
    CommandRefusedError,
    DeviceSilentError,
    LimitTrippedError,
    UnknownNameError,
    UsageError,
)
from labhil.experiment.devices import host_config
from labhil.experiment.experiment import TWIN
from labhil.experiment.plan import DevicePlan
from labhil.experiment.twins import start_twin
from labhil.host_clock import session_clock, unix_ns
from labhil.service.hosts import ConnectedDevice, HostProcess
from labhil.service.messages import WATCHDOG, HostState, Setpoint
from labhil.signals import FloatArray, Signal

HOLDER = "Python"
PATIENCE = 10.0
"""How long the bus may take to find the host, s."""
KEEP = 0.5
"""Share of the watchdog's time after which a command that is held is sent again."""
LONGEST = 1_000_000
"""Samples that are kept until they are read."""


class Bench:
    """A connected device. Made by :func:`labhil.connect`; a context manager.

    The driver runs in a process of its own, which clips commands to the limits of the rig file, brings the
    device to its safe state when they stop for 0.22 s, when a sample leaves its limits, or when this process
    ends.

    Example:
        >>> import labhil as lh
        >>> with lh.connect("ball_beam", "twin") as bench:
        ...     sample = bench.read()
        ...     applied = bench.command(servo_angle=0.1, hold=0.3)
        ...     run = bench.collect(0.5)
        >>> sorted(sample)
        ['ball_position', 'servo_angle', 't']
        >>> applied["servo_angle"]
        0.1
        >>> run["ball_position"].shape == run["t"].shape
        True
    """

    def __init__(self, plan: DevicePlan) -> None:
        self._plan = plan
        self._arrived: deque[tuple[float, FloatArray]] = deque(maxlen=LONGEST)
        self._news = threading.Event()
        self._resources = ExitStack()
        self._token = ""
        self._bus: Bus | None = None
        self._device: ConnectedDevice | None = None
        self._host: HostProcess | None = None

    @property
    def spec(self) -> DriverSpec:
        """What the driver declares: commands, limits of the device, its safe state."""
        return self._plan.spec

    @property
    def signals(self) -> Mapping[str, Signal]:
        """What the device says, by name, each with its unit."""
        return {signal.name: signal for signal in self._require_device().stream.signals}

    @property
    def rate(self) -> float:
        """Samples per second of the device's clock."""
        return self._require_device().stream.rate

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            resources.enter_context(session_clock())
            self._bus = bus = resources.enter_context(open_bus())
            address = self._plan.section.address
            if address == TWIN:
                address = self._start_twin(resources)
            self._host = host = HostProcess(host_config(self._plan, address, bus.endpoint))
            resources.callback(host.stop)
            self._device = host.wait_connected()
            self._codec = Codec(self._device.stream)
            key = stream_key(self._plan.name, self._device.stream.name)
            resources.enter_context(subscribe(bus, key, self._take, Refusals()))
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._device = None
        self._resources.close()

    def read(self, timeout: float = 1.0) -> dict[str, float | FloatArray]:
        """Wait for a new sample and return it.

        Args:
            timeout: Longest wait, s.

        Returns:
            Values by signal name in SI units, a vector as an array; ``t`` is the device's clock, s.

        Raises:
            DeviceSilentError: Nothing came.
        """
        self._require_device()
        self._arrived.clear()
        self._wait(1, timeout)
        t, row = self._arrived[-1]
        columns = self._columns(row[None])
        return {"t": t, **{name: float(x[0]) if x.ndim == 1 else x[0] for name, x in columns.items()}}

    def collect(self, duration: float) -> dict[str, FloatArray]:
        """Take in all samples for a while.

        Args:
            duration: How long, s of the host's clock.

        Returns:
            Arrays by signal name in SI units, (n,) or (n, k); ``t`` (n,) is the device's clock, s.

        Raises:
            DeviceSilentError: Nothing came.
        """
        if not 0.0 < duration < float("inf"):
            raise UsageError(f"duration: expected more than 0 s, found {duration!r}")
        self._require_device()
        self._arrived.clear()
        time.sleep(duration)
        self._wait(1, 1.0)
        rows = list(self._arrived)
        return {
            "t": np.array([t for t, _ in rows]),
            **self._columns(np.array([row for _, row in rows])),
        }

    def command(self, hold: float = 0.0, **values: float) -> dict[str, float]:
        """Set what the device takes, by signal name, in SI units.

        A command stands until the watchdog finds that no more have come for 0.22 s; then the device goes to
        its safe state. Call this again in time, or let it ``hold``.

        Args:
            hold: How long to repeat the command before this returns, s.
            values: The signals to set: ``servo_angle=0.1``.

        Returns:
            What was applied, by signal name: the limits may allow less than was asked for.

        Raises:
            UnknownNameError: The device takes no such command.
            CommandRefusedError: A value beyond the limits, the emergency stop is pressed, or somebody else
                commands the device.
            LimitTrippedError: A sample left the limits of the rig file; see :meth:`rearm`.
        """
        known = [column for signal in self.spec.commands for column in signal.columns()]
        for name, value in values.items():
            if name not in known:
                raise UnknownNameError(f"command of {self.spec.name}", name, known)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise UsageError(f"{name}: expected a number, found {value!r}")
        if not values:
            raise UsageError(f"command: expected a value for at least one of {', '.join(known)}")
        numbers = {name: float(value) for name, value in values.items()}
        deadline = time.monotonic() + hold
        applied = self._set(numbers)
        while (remaining := deadline - time.monotonic()) > 0.0:
            time.sleep(min(remaining, KEEP * WATCHDOG))
            applied = self._set(numbers)
        return applied

    def safe(self) -> None:
        """Bring the device to its safe state."""
        ask(self._on_bus(), command_key(self._plan.name, "safe"), {"reason": "asked for from Python"})

    def rearm(self) -> None:
        """Let the device be commanded again after it left its limits; nothing moves by that.

        Raises:
            CommandRefusedError: What stopped it still stands, or somebody else commands it.
        """
        request = {"action": "take", "holder": HOLDER}
        answer = ask(self._on_bus(), command_key(self._plan.name, "lease"), request, patience=PATIENCE)
        self._token = str(answer["token"])

    def _start_twin(self, resources: ExitStack) -> str:
        folder = resources.enter_context(tempfile.TemporaryDirectory(prefix="labhil-twin-"))
        section, answer = self._plan.section, Path(folder) / "twin.json"
        twin, address = start_twin(self._plan.name, section.plugin, section.twin, answer, lambda: False)
        resources.callback(twin.stop)
        return address

    def _require_device(self) -> ConnectedDevice:
        if self._device is None:
            raise UsageError("the device is not connected: use `with labhil.connect(…) as bench:`")
        failure = None if self._host is None else self._host.failure()
        if failure is not None:
            raise failure
        return self._device

    def _on_bus(self) -> Bus:
        self._require_device()
        assert self._bus is not None
        return self._bus

    def _take(self, _key: str, payloads: list[bytes]) -> None:
        batch = self._codec.decode([payload for payload in payloads if self._codec.is_own(payload)])
        self._arrived.extend(zip((batch.t_hw_ns * 1e-9).tolist(), batch.values, strict=True))
        self._news.set()

    def _wait(self, samples: int, timeout: float) -> None:
        deadline = time.monotonic() + timeout
        while len(self._arrived) < samples:
            self._news.clear()
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                self._require_device()
                raise DeviceSilentError(
                    f"{self._plan.name}: expected a sample within {timeout:g} s, found none"
                )
            self._news.wait(min(remaining, 0.1))

    def _columns(self, rows: FloatArray) -> dict[str, FloatArray]:
        stream = self._require_device().stream
        columns = {signal.name: rows[:, stream.columns_of(signal.name)] for signal in stream.signals}
        return {name: x[:, 0] if x.shape[1] == 1 else x for name, x in columns.items()}

    def _set(self, values: Mapping[str, float]) -> dict[str, float]:
        """Send values; the lease is taken anew where the watchdog has ended it, but not after a trip."""
        bus, name = self._on_bus(), self._plan.name
        for last in (False, True):
            status = ask(bus, command_key(name, "status"), patience=PATIENCE)
            if status["state"] == HostState.TRIPPED.value:
                raise LimitTrippedError(f"{name}: {status['reason']}; `rearm()` lets it be commanded again")
            if status["holder"] is None:
                self.rearm()
            setpoint = Setpoint(self._token, unix_ns(), dict(values))
            try:
                answer = ask(bus, command_key(name, "set"), setpoint.to_json())
            except CommandRefusedError:
                if last or status["holder"] is None:
                    raise
                continue  # the watchdog came in between
            break
        return {column: float(answer["applied"][column]) for column in values}
