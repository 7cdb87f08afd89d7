"""One device from Python: samples in, commands out, under the limits and the watchdog of its host."""

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
HOST_DISCOVERY_TIMEOUT = 10.0
"""How long the bus may take to find the host, s."""
RESEND_SHARE = 0.5
"""A command that is held is sent again after this share of the watchdog's time."""
MAX_WAITING = 1_000_000
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
        self._arrived: deque[tuple[float, FloatArray]] = deque(maxlen=MAX_WAITING)
        self._news = threading.Event()
        self._resources = ExitStack()
        self._token = ""
        self._bus: Bus | None = None
        self._device: ConnectedDevice | None = None
        self._host: HostProcess | None = None

    @property
    def spec(self) -> DriverSpec:
        """The declaration of the driver: commands, ranges and safe state of the device."""
        return self._plan.spec

    @property
    def signals(self) -> Mapping[str, Signal]:
        """The signals of the device by name, each with its unit."""
        return {signal.name: signal for signal in self._require_device().stream.signals}

    @property
    def rate(self) -> float:
        """Sample rate, Hz of the device's clock."""
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
            resources.enter_context(subscribe(bus, key, self._take_samples, Refusals()))
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
            DeviceSilentError: No sample came in time.
        """
        self._require_device()
        self._arrived.clear()
        self._wait(1, timeout)
        t, row = self._arrived[-1]
        columns = self._columns(row[None])
        return {"t": t, **{name: float(x[0]) if x.ndim == 1 else x[0] for name, x in columns.items()}}

    def collect(self, duration: float) -> dict[str, FloatArray]:
        """Collect all samples for some time.

        Args:
            duration: How long, s of the host's clock.

        Returns:
            Arrays by signal name in SI units, (n,) or (n, k); ``t`` (n,) is the device's clock, s.

        Raises:
            DeviceSilentError: No sample came.
        """
        if not 0.0 < duration < float("inf"):
            raise UsageError(f"duration: expected more than 0 s, found {duration!r}")
        self._require_device()
        self._arrived.clear()
        time.sleep(duration)
        self._wait(1, 1.0)
        return self.received()

    def received(self) -> dict[str, FloatArray]:
        """Return the samples that have come in since the last call, or the last read; does not wait.

        What came while :meth:`command` held a value is among them.

        Returns:
            Arrays by signal name in SI units, (n,) or (n, k); ``t`` (n,) is the device's clock, s.
        """
        width = self._require_device().stream.width
        rows = [self._arrived.popleft() for _ in range(len(self._arrived))]
        return {
            "t": np.array([t for t, _ in rows]),
            **self._columns(np.array([row for _, row in rows]).reshape(len(rows), width)),
        }

    def command(self, hold: float = 0.0, **values: float) -> dict[str, float]:
        """Set commands of the device, by signal name, in SI units.

        A command holds until no further one has come for 0.22 s (the watchdog); the device then goes to its
        safe state. Call this again in time, or let it ``hold``.

        Args:
            hold: How long to repeat the command before this returns, s.
            values: The signals to set: ``servo_angle=0.1``.

        Returns:
            What was applied, by signal name: the limits may allow less than was requested.

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
            time.sleep(min(remaining, RESEND_SHARE * WATCHDOG))
            applied = self._set(numbers)
        return applied

    def safe(self) -> None:
        """Bring the device to its safe state."""
        ask(self._require_bus(), command_key(self._plan.name, "safe"), {"reason": "asked for from Python"})

    def rearm(self) -> None:
        """Allow commands again after the device left its limits; nothing moves by that.

        Raises:
            CommandRefusedError: The cause of the stop is still there, or somebody else commands the device.
        """
        request = {"action": "take", "holder": HOLDER}
        answer = ask(
            self._require_bus(),
            command_key(self._plan.name, "lease"),
            request,
            patience=HOST_DISCOVERY_TIMEOUT,
        )
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

    def _require_bus(self) -> Bus:
        self._require_device()
        assert self._bus is not None
        return self._bus

    def _take_samples(self, _key: str, payloads: list[bytes]) -> None:
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
        """Send values; take the lease again where the watchdog has ended it, but not after a trip."""
        bus, name = self._require_bus(), self._plan.name
        for is_last in (False, True):
            status = ask(bus, command_key(name, "status"), patience=HOST_DISCOVERY_TIMEOUT)
            if status["state"] == HostState.TRIPPED.value:
                raise LimitTrippedError(f"{name}: {status['reason']}; `rearm()` lets it be commanded again")
            if status["holder"] is None:
                self.rearm()
            setpoint = Setpoint(self._token, unix_ns(), dict(values))
            try:
                answer = ask(bus, command_key(name, "set"), setpoint.to_json())
            except CommandRefusedError:
                if is_last or status["holder"] is None:
                    raise
                continue  # the watchdog acted in between
            break
        return {column: float(answer["applied"][column]) for column in values}
