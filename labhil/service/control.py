"""The thread that owns a device: what it sends there, what it takes from there, and when it stops it.

All state belongs to one thread, the one in :meth:`DeviceControl.run`. Whatever comes from the bus is put
into its inbox; only ``safe`` reaches past it, since a device must be stopped even when that thread hangs.
"""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import Any, Self

from labhil.bus.ask import serve
from labhil.bus.keys import command_key, setpoint_key
from labhil.bus.live import announce
from labhil.bus.publish import StreamPublisher, publish_event
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.driver import DeviceInfo, Driver, TimedDriver
from labhil.errors import BusError, CommandRefusedError, DeviceSilentError
from labhil.service.lease import Lease
from labhil.service.limits import CommandLimits, SampleLimits
from labhil.service.messages import HostConfig, HostState, Setpoint
from labhil.signals import Batch, Direction, Signal, Stream

READ_TIMEOUT = 0.002
"""Longest wait for samples, s: how late a setpoint may reach the driver."""
REACTION = 0.25
"""Share of the sample period that the setpoint after a sample is waited for."""
SILENCE = 1.0
"""How long a connected device may say nothing, s of the host's clock."""
ANSWER_TIMEOUT = 1.0
"""How long a command waits for the control thread, s."""
LONGEST_STALL = 0.05
"""What one turn of the loop may count for in the watchdog, s: our own stalls are nobody's silence."""

COMMANDS = ("status", "set", "safe", "lease", "shutdown")


def command_stream(state: Stream, commands: tuple[Signal, ...]) -> Stream:
    """Return the declaration of what was requested and what was sent, per command signal."""
    signals: list[Signal] = []
    for signal in commands:
        for suffix, what in (("requested", "before limits"), ("applied", "sent to the device")):
            signals.append(
                Signal(
                    f"{signal.name}_{suffix}",
                    signal.unit,
                    Direction.REQUESTED,
                    width=signal.width,
                    hold=signal.hold,
                    description=f"{signal.name}, {what}",
                )
            )
    return Stream("command", tuple(signals), state.rate)


@dataclass(slots=True)
class Request:
    """Something from the bus for the control thread; without ``answer`` nobody waits for one."""

    name: str
    payload: Any
    answer: Future[dict[str, Any]] | None = None


@dataclass(slots=True)
class Commanded:
    """What is asked of a device and what it was sent last; host times on the monotonic clock, s."""

    requested: dict[str, float]
    applied: dict[str, float]
    sent_at: float = 0.0
    sent_for_ns: int | None = None
    unheard: float = 0.0
    count: int = 0


@dataclass(slots=True)
class Clock:
    """The device's clock at its newest sample, and when that came; ns."""

    t_hw_ns: int = 0
    t_acq_ns: int = 0

    def at(self, t_ns: int, speed: float) -> int:
        """Return the device's clock at Unix time ``t_ns``."""
        return self.t_hw_ns + round((t_ns - self.t_acq_ns) * speed)


class DeviceControl:
    """Runs one connected driver on the bus; a context manager around :meth:`run`.

    ``ended`` is asked once per turn and returns why it is time to end, or an empty string.
    """

    def __init__(
        self, config: HostConfig, driver: Driver, info: DeviceInfo, bus: Bus, ended: Callable[[], str]
    ) -> None:
        self._config, self._driver, self._info, self._bus, self._ended = config, driver, info, bus, ended
        spec = driver.spec
        self.state = HostState.IDLE
        self._reason = "connected"
        self._timed = driver if isinstance(driver, TimedDriver) else None
        self._lease = Lease()
        self._command_limits = CommandLimits(spec.commands, config.limits)
        self._sample_limits = SampleLimits(spec.stream, spec.commands, config.limits)
        self._commanded = Commanded(dict(spec.safe), dict(spec.safe))
        self._clock = Clock(0, time.time_ns())
        self._shut_down_reason = ""
        self._refused: set[str] = set()
        self._violation: str | None = None
        self._heard_at = 0.0
        self._inbox: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self._resources = ExitStack()
        # a controller answers each sample with a setpoint: wait for it here, and not for the next sample
        self._reaction_time = REACTION / (spec.stream.rate * info.speed)
        # what the device itself would wait for, in the host's time, four times over
        self._keep_alive = spec.command_timeout / info.speed / 4

    def __enter__(self) -> Self:
        config, spec, bus = self._config, self._driver.spec, self._bus
        metadata = stream_metadata(config, self._driver, self._info)
        with ExitStack() as resources:
            self._states = StreamPublisher(bus, config.device, spec.stream, metadata)
            resources.callback(self._states.close)
            commands = command_stream(spec.stream, spec.commands)
            self._commands = StreamPublisher(bus, config.device, commands, metadata)
            resources.callback(self._commands.close)
            self._command_width = commands.width
            for name in COMMANDS:
                resources.enter_context(serve(bus, command_key(config.device, name), self._handler(name)))
            resources.enter_context(subscribe(bus, setpoint_key(config.device), self._take_setpoints))
            resources.enter_context(announce(bus, config.device))
            self._resources = resources.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def run(self) -> str:
        """Serve the device until something ends it, and return what did; the device is safe then.

        Raises what the driver raises; the device is brought to its safe state then, too.
        """
        self._heard_at = before = time.monotonic()
        try:
            while not (reason := self._ended() or self._shut_down_reason):
                batch = self._driver.read(READ_TIMEOUT)
                now = time.monotonic()
                if len(batch):
                    self._heard_at = now
                    self._take_in(batch)
                elif now - self._heard_at > SILENCE:
                    raise DeviceSilentError(
                        f"{self._config.address}: the device said nothing for {SILENCE:g} s; "
                        f"expected {self._driver.spec.stream.rate * self._info.speed:g} samples per second"
                    )
                answer_is_due = len(batch) > 0 and self.state is HostState.ACTIVE
                self._answer_requests(now, self._reaction_time if answer_is_due else 0.0)
                self._keep_watch(now, now - before)
                before = now
        finally:
            self._driver.safe()
        self._become(HostState.STOPPED, reason)
        return reason

    # what comes from the device

    def _take_in(self, batch: Batch) -> None:
        self._clock = Clock(int(batch.t_hw_ns[-1]), int(batch.t_acq_ns[-1]))
        self._states.put(batch)
        self._violation = self._sample_limits.violation(batch) or self._trouble()
        if self._violation is not None and self.state is not HostState.TRIPPED:
            self._to_safety(HostState.TRIPPED, self._violation)

    def _trouble(self) -> str | None:
        return (self._timed.trouble() or None) if self._timed is not None else None

    # what comes from the bus, still in the bus's threads

    def _take_setpoints(self, _key: str, payloads: list[bytes]) -> None:
        for payload in payloads:
            self._inbox.put(Request("setpoint", payload))

    def _handler(self, name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
        def handle(payload: dict[str, Any]) -> dict[str, Any]:
            if name == "safe":
                self._driver.safe()
            request = Request(name, payload, Future())
            assert request.answer is not None
            self._inbox.put(request)
            try:
                return request.answer.result(ANSWER_TIMEOUT)
            except TimeoutError:
                raise BusError(
                    f"the host of {self._config.device!r} did not answer within {ANSWER_TIMEOUT:g} s"
                ) from None

        return handle

    # the control thread again

    def _answer_requests(self, now: float, patience: float) -> None:
        """Take what is in the inbox; where nothing is, wait up to ``patience`` s for the first."""
        while True:
            try:
                request = self._inbox.get(timeout=patience) if patience > 0 else self._inbox.get_nowait()
            except queue.Empty:
                return
            patience = 0.0
            try:
                answer = self._obey(request, now)
            except CommandRefusedError as error:
                if request.answer is None:
                    self._refuse_once(str(error))
                else:
                    request.answer.set_exception(error)
            else:
                if request.answer is not None:
                    request.answer.set_result(answer)

    def _obey(self, request: Request, now: float) -> dict[str, Any]:
        if request.name == "setpoint":
            return self._follow(request.payload, now)
        if request.name == "set":
            return self._set(request.payload, now)
        if request.name == "lease":
            return self._take_lease(request.payload, now)
        if request.name == "safe":
            return self._safe(request.payload)
        if request.name == "shutdown":
            self._shut_down_reason = "told to shut down"
        return self._status(now)

    def _refuse_once(self, message: str) -> None:
        if message not in self._refused:
            self._refused.add(message)
            self._announce("refused", message)

    def _status(self, now: float) -> dict[str, Any]:
        return {
            "state": self.state.value,
            "reason": self._reason,
            "holder": self._lease.holder if self._lease.is_held(now) else None,
            "applied": self._commanded.applied,
            "counters": asdict(self._driver.counters),
            "overflows": self._states.overflows + self._commands.overflows,
        }

    def _take_lease(self, payload: dict[str, Any], now: float) -> dict[str, Any]:
        action = payload.get("action", "take")
        if action == "take":
            if self._violation is not None:
                raise CommandRefusedError(f"the device is outside its limits: {self._violation}")
            holder = str(payload.get("holder", "somebody"))
            token = self._lease.take(holder, now)
            self._refused.clear()
            self._become(HostState.IDLE, f"lease taken by {holder!r}", "leased")
            return {"token": token}
        if action not in ("renew", "return"):
            raise CommandRefusedError(f'lease: action is "take", "renew" or "return", found {action!r}')
        self._lease.renew(str(payload.get("token", "")), now)
        if action == "return":
            self._to_safety(HostState.IDLE, "lease returned", "returned")
        else:
            self._commanded.unheard = 0.0
        return {}

    def _safe(self, payload: dict[str, Any]) -> dict[str, Any]:
        self._to_safety(HostState.IDLE, str(payload.get("reason", "told to")), "safe")
        return {"applied": self._commanded.applied}

    def _set(self, payload: dict[str, Any], now: float) -> dict[str, Any]:
        setpoint = Setpoint.from_json(payload)
        self._admit(setpoint, now)
        self._command_limits.refuse_beyond(setpoint.values)
        self._apply(setpoint, now)
        return {"requested": self._commanded.requested, "applied": self._commanded.applied}

    def _follow(self, payload: bytes, now: float) -> dict[str, Any]:
        setpoint = Setpoint.from_bytes(payload)
        self._admit(setpoint, now)
        self._command_limits.refuse_unusable(setpoint.values)
        self._apply(setpoint, now)
        return {}

    def _admit(self, setpoint: Setpoint, now: float) -> None:
        # the lease comes first: a stale setpoint must not keep it alive
        age = (time.time_ns() - setpoint.t_ns) * 1e-9
        if age > self._config.watchdog:
            raise CommandRefusedError(f"stale: a setpoint may be {self._config.watchdog:g} s old")
        self._lease.renew(setpoint.token, now)

    def _apply(self, setpoint: Setpoint, now: float) -> None:
        commanded = self._commanded
        if self.state is not HostState.ACTIVE:
            # the first command may move as far as one sample allows, not as far as the pause was long
            commanded.sent_at = now - 1 / (self._driver.spec.stream.rate * self._info.speed)
            self._become(HostState.ACTIVE, f"commanded by {self._lease.holder!r}")
        commanded.requested.update(setpoint.values)
        commanded.unheard = 0.0
        self._send(now, setpoint.t_hw_ns)

    def _send(self, now: float, t_hw_ns: int | None = None) -> None:
        commanded = self._commanded
        elapsed = self._elapsed(now, t_hw_ns)
        commanded.applied = {
            name: self._command_limits.clipped(name, value, commanded.applied.get(name), elapsed)
            for name, value in commanded.requested.items()
        }
        commanded.sent_at = now
        if self._timed is not None and t_hw_ns is not None:
            commanded.sent_for_ns = t_hw_ns
            self._timed.command_at(commanded.applied, t_hw_ns)
        else:
            self._driver.command(commanded.applied)
        self._record_command(commanded)

    def _elapsed(self, now: float, t_hw_ns: int | None) -> float:
        """How long what was sent before has had its effect, s of the device's clock."""
        before = self._commanded.sent_for_ns
        if self._timed is None:
            return (now - self._commanded.sent_at) * self._info.speed
        if t_hw_ns is None or before is None:
            return math.inf  # the driver takes its own time to get there
        return (t_hw_ns - before) * 1e-9

    def _record_command(self, commanded: Commanded) -> None:
        t_ns = time.time_ns()
        row = [
            values.get(column, math.nan)
            for signal in self._driver.spec.commands
            for values in (commanded.requested, commanded.applied)
            for column in signal.columns()
        ]
        t_hw_ns = self._clock.at(t_ns, self._info.speed)
        self._commands.put(Batch.of([(commanded.count, t_ns, t_hw_ns, row)], self._command_width))
        commanded.count += 1

    def _keep_watch(self, now: float, turn: float) -> None:
        if self.state is not HostState.ACTIVE:
            return
        self._commanded.unheard += min(turn, LONGEST_STALL)
        if self._commanded.unheard > self._config.watchdog:
            stopped = f"watchdog: commands stopped for {self._config.watchdog:g} s"
            if now - self._heard_at > self._config.watchdog / 2:
                # a controller that follows the samples has nothing to say when there are none
                self._to_safety(HostState.IDLE, f"{stopped}, as the device sends no samples", "quiet")
            else:
                self._to_safety(HostState.IDLE, stopped, "watchdog")
        elif now - self._commanded.sent_at > self._keep_alive:
            self._send(now)

    def _to_safety(self, state: HostState, reason: str, kind: str | None = None) -> None:
        self._driver.safe()
        self._lease.revoke()
        safe = self._driver.spec.safe
        self._commanded.requested, self._commanded.applied = dict(safe), dict(safe)
        self._commanded.sent_for_ns = None
        self._become(state, reason, kind)

    def _become(self, state: HostState, reason: str, kind: str | None = None) -> None:
        self.state, self._reason = state, reason
        self._announce(kind or state.value, reason)

    def _announce(self, kind: str, message: str) -> None:
        data = {"t_ns": time.time_ns(), "kind": kind, "state": self.state.value, "message": message}
        publish_event(self._bus, self._config.device, data)


def stream_metadata(config: HostConfig, driver: Driver, info: DeviceInfo) -> dict[str, str]:
    """Return what is said of a device beside its samples: strings, as a recording wants them."""
    return {
        "plugin": config.plugin,
        "rig": driver.spec.rig,
        "address": config.address,
        "firmware": info.firmware,
        "serial": info.serial,
        "boot_id": str(info.boot_id),
        "speed": repr(info.speed),
        **{f"calibration.{name}": repr(value) for name, value in info.calibration.items()},
    }
