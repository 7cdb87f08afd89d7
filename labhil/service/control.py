"""The control loop of a host: reads samples, sends commands, and brings the device to its safe state.

All state belongs to the thread of :meth:`DeviceControl.run`. Requests from the bus go into its inbox; only
``safe`` and ``estop`` also act directly on the driver, since a device must stop even when that thread hangs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from typing import Any, Self

from labhil.bus.ask import Responder, serve
from labhil.bus.authentication import Refusals
from labhil.bus.incoming import AnyRequest, EstopRequest, LeaseRequest, SafeRequest, SetpointMessage
from labhil.bus.keys import command_key, setpoint_key
from labhil.bus.live import announce
from labhil.bus.publish import StreamPublisher, publish_event
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.driver import DeviceInfo, Driver
from labhil.errors import BusError, CommandRefusedError, DeviceError, DeviceSilentError
from labhil.host_clock import unix_ns
from labhil.service.commands import COMMANDS, is_guarded, reader_of
from labhil.service.contact import Contact
from labhil.service.declared import command_stream, stream_metadata
from labhil.service.inbox import Inbox
from labhil.service.interlocks import Interlocks
from labhil.service.latch import HostLatch
from labhil.service.lease import Lease
from labhil.service.limits import SampleLimits
from labhil.service.messages import HostConfig, HostState, Setpoint
from labhil.service.output import Clock, Output
from labhil.service.reconnect import SEARCH_TIMEOUT, Continuation, Search, refuse_another
from labhil.signals import Batch

READ_TIMEOUT, IDLE_TIMEOUT = 0.002, 0.01
"""Longest waits for samples, s, with and without a lease; they bound the delay of setpoints and requests."""
REACTION_SHARE = 0.25
"""Share of the sample period for which the loop waits for the setpoint after a sample."""
MAX_TURN = 0.05
"""What one turn of the loop counts for in the watchdog at most, s: its own delays are no missing commands."""

MAX_SETPOINTS = 256
"""Streamed setpoints that may wait; behind more, the setpoints of a flooded host would come too late."""

STEADY = (HostState.IDLE, HostState.ACTIVE)


class DeviceControl:
    """Runs one connected driver on the bus; a context manager around :meth:`run`.

    ``ended`` is called once per turn and returns the reason to end, or an empty text.
    """

    def __init__(
        self, config: HostConfig, driver: Driver, info: DeviceInfo, bus: Bus, ended: Callable[[], str]
    ) -> None:
        self._config, self._driver, self._info, self._bus, self._ended = config, driver, info, bus, ended
        spec = driver.spec
        self.state = HostState.IDLE
        self._reason = "connected"
        self._lease = Lease()
        self._output = Output(driver, config.limits, info.speed)
        self._sample_limits = SampleLimits(spec.stream, spec.commands, config.limits)
        self._interlocks = Interlocks(spec.stream, config.interlocks)
        self._latch = HostLatch()
        self._answers: dict[str, Callable[[Any, float], dict[str, Any]]] = {
            "setpoint": self._follow, "set": self._set, "lease": self._take_lease, "safe": self._make_safe,
            "estop": self._estop, "shutdown": self._shut_down, "status": self._status,
        }  # fmt: skip
        self._shut_down_reason = ""
        self._announced_refusals: set[str] = set()
        self._refusals = Refusals(lambda text: self._announce("rejected", text))
        self._violation: str | None = None
        rate = spec.stream.rate * info.speed
        self._contact = Contact(config, driver, rate)
        self._is_silent = False
        self._is_recovering = False
        self._continuation = Continuation(rate, info.speed)
        self._inbox = Inbox(config.device)
        self._resources = ExitStack()
        # a controller answers each sample with a setpoint: wait for it, not for the next sample
        self._reaction_time = REACTION_SHARE / rate
        # a command is repeated four times within the device's own timeout
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
            for name in COMMANDS:
                resources.enter_context(self._serve_command(name))
            setpoints = subscribe(
                bus, setpoint_key(config.device), self._inbox.put_setpoints, self._refusals,
                depth=MAX_SETPOINTS, commands=True,
            )  # fmt: skip
            resources.enter_context(setpoints)
            resources.enter_context(announce(bus, config.device))
            self._resources = resources.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def _serve_command(self, name: str) -> Responder:
        key, handler = command_key(self._config.device, name), self._handler(name)
        return serve(
            self._bus, key, handler, reader=reader_of(name), guarded=partial(is_guarded, name),
            refusals=self._refusals,
        )  # fmt: skip

    def run(self) -> str:
        """Serve the device until an end is requested, and return the reason; the device is safe then.

        Raises DeviceError or BusError where the driver or the bus fails; the device is safe then, too.
        """
        previous = time.monotonic()
        self._contact.restart()
        try:
            while not (reason := self._ended() or self._shut_down_reason):
                try:
                    now = self._turn(previous)
                except DeviceError as error:
                    if not self._config.reconnect:
                        raise
                    self._search_device(error)
                    self._contact.restart()
                    now = time.monotonic()
                previous = now
        finally:
            self._driver.safe()
        self._transition(HostState.STOPPED, reason, counters=asdict(self._driver.counters))
        return reason

    def _turn(self, previous: float) -> float:
        """Read samples, answer requests and check the watchdog; return the time of this turn."""
        self._check_bus()
        batch = self._driver.read(READ_TIMEOUT if self._lease.is_held(previous) else IDLE_TIMEOUT)
        self._contact.check_standstill()
        now = time.monotonic()
        if len(batch):
            self._contact.note_samples(now)
            self._take_in(self._continuation.apply(batch))
            self._check_commands_arrive(now)
        else:
            self._contact.check_silence(now)
        self._check_latch(now)
        answer_is_due = len(batch) > 0 and self.state is HostState.ACTIVE
        if self._contact.has_samples:  # earlier requests wait for the first sample, which shows the state
            self._answer_requests(now, self._reaction_time if answer_is_due else 0.0)
        self._check_watchdog(now, now - previous)
        return now

    def _check_commands_arrive(self, now: float) -> None:
        """Start again from the safe output where the device made itself safe, though its samples come in.

        Raises DeviceSilentError where lost devices are reconnected: the device has to confirm its
        configuration then.
        """
        message = self._contact.lost_commands()
        if not message or self.state is not HostState.ACTIVE:
            return
        if self._config.reconnect:
            raise DeviceSilentError(message)
        self._output.begin_from_safe(now)
        self._announce("unheard", message)

    def _check_bus(self) -> None:
        """Raise BusError where a part of the bus failed: a host that hears nothing must not command."""
        if fault := self._bus.failure():
            raise BusError(f"the host of {self._config.device!r}: {fault}")

    def _search_device(self, error: DeviceError) -> None:
        """Try to connect again while answering requests; raises the error of the last attempt."""
        self._to_safety(HostState.RECONNECTING, f"{error}; looking for it again", "lost")
        lost_at = time.monotonic()
        search = Search(self._driver, math.inf if self._config.patient else SEARCH_TIMEOUT)
        try:
            while (info := search.result(READ_TIMEOUT)) is None:
                if self._ended() or self._shut_down_reason:
                    return
                self._check_bus()
                now = time.monotonic()
                self._check_latch(now)
                self._answer_requests(now, 0.0)
        finally:
            search.cancel()
        refuse_another(self._config.address, self._info, info)
        same_boot = info.boot_id == self._info.boot_id
        boot = "the same boot" if same_boot else "it has booted again"
        self._info = info
        self._is_silent = False
        self._contact.restart()
        self._continuation.note_new_connection(same_boot=same_boot)
        gap = time.monotonic() - lost_at
        self._note_return(f"after {gap:.2f} s the device is back, its configuration sent again: {boot}")

    def _note_return(self, message: str) -> None:
        state = HostState.IDLE if self._latch.standing is None else HostState.LATCHED
        self._transition(state, message, "reconnected")

    def _check_latch(self, now: float) -> None:
        self._latch.poll(now)
        stop = self._latch.standing
        if stop is not None and self.state not in (HostState.LATCHED, HostState.RECONNECTING):
            self._to_safety(HostState.LATCHED, stop.describe(), "estop")

    # what comes from the device

    def _take_in(self, batch: Batch) -> None:
        self._output.clock = Clock(int(batch.t_hw_ns[-1]), int(batch.t_acq_ns[-1]))
        self._states.put(batch)
        limit_violation = self._sample_limits.violation(batch)
        self._violation = limit_violation or self._output.fault()
        if limit_violation is None and self._config.reconnect:
            self._note_recovery()
        if self._violation is not None and not self._is_recovering and self.state in STEADY:
            self._to_safety(HostState.TRIPPED, self._violation)
        if (tripped := self._interlocks.take_in(batch)) is not None:
            state = HostState.LATCHED if self.state is HostState.LATCHED else HostState.TRIPPED
            self._to_safety(state, tripped.message, "interlock", then=tripped.then)
        if self._is_silent:
            self._is_silent = False
            self._note_return("the device sends samples again")

    def _note_recovery(self) -> None:
        """Note that the driver recovers from a fault by itself while samples go on, or that it has."""
        recovering = self._violation is not None and self._output.is_transient()
        if recovering and not self._is_recovering and self.state in STEADY:
            self._is_recovering = True
            self._to_safety(HostState.IDLE, str(self._violation), "lost")
        elif self._is_recovering and not recovering:
            self._is_recovering = False
            if self._violation is None and self.state in STEADY:
                self._note_return("the device can be commanded again")

    def _handler(self, name: str) -> Callable[[Any], dict[str, Any]]:
        """What answers a command in the bus' thread: a stop acts at once, the rest waits for its turn."""

        def handle(payload: Any) -> dict[str, Any]:
            is_stop = isinstance(payload, EstopRequest) and payload.action == "press"
            if is_stop:
                self._latch.press(payload.by, payload.reason)
            if is_stop or name == "safe":
                self._driver.safe()
            return self._inbox.ask(name, payload)

        return handle

    def _answer_requests(self, now: float, patience: float) -> None:
        """Answer the requests in the inbox; where there are none, wait up to ``patience`` s for the first."""
        for request in self._inbox.take(patience):
            try:
                answer = self._answers[request.name](request.payload, now)
            except DeviceSilentError as error:
                request.fail(CommandRefusedError(str(error)))
                raise
            except CommandRefusedError as error:
                request.fail(error)
                if request.answer is None:
                    self._check_latch(now)  # an emergency stop is announced before the refusal it causes
                    self._refuse_once(str(error))
            else:
                request.succeed(answer)

    def _refuse_once(self, message: str) -> None:
        if message not in self._announced_refusals:
            self._announced_refusals.add(message)
            self._announce("refused", message)

    def _shut_down(self, payload: AnyRequest, now: float) -> dict[str, Any]:
        self._shut_down_reason = "requested to shut down"
        return self._status(payload, now)

    def _status(self, _payload: AnyRequest, now: float) -> dict[str, Any]:
        return {
            "state": self.state.value,
            "reason": self._reason,
            "holder": self._lease.holder if self._lease.is_held(now) else None,
            "lease_left": self._lease.remaining(now),
            "objection": self._objection(),
            "age": self._contact.silence(now),
            "applied": self._output.applied,
            "counters": asdict(self._driver.counters),
            "overflows": self._states.overflows + self._commands.overflows,
            "refused": dict(self._refusals.counts),
        }

    def _take_lease(self, request: LeaseRequest, now: float) -> dict[str, Any]:
        if request.action == "take":
            if (objection := self._objection()) is not None:
                raise CommandRefusedError(objection)
            token = self._lease.take(request.holder, now)
            self._announced_refusals.clear()
            self._transition(HostState.IDLE, f"lease taken by {request.holder!r}", "leased")
            return {"token": token}
        self._lease.renew(request.token, now)
        if request.action == "return":
            self._to_safety(HostState.IDLE, "lease returned", "returned")
        else:
            self._output.unheard = 0.0
        return {}

    def _objection(self) -> str | None:
        """Return why the device cannot be commanded now; None where it can."""
        if self._latch.standing is not None:
            return f"{self._latch.standing.describe()}; release it with `labhil estop --release`"
        if self.state is HostState.RECONNECTING:
            return f"the device is not connected: {self._reason}"
        if self._violation is not None:
            return f"the device cannot be commanded: {self._violation}"
        return self._interlocks.standing()

    def _make_safe(self, request: SafeRequest, _now: float) -> dict[str, Any]:
        # a trip, a latch and a lost device persist: a request to be safe ends none of them
        state = HostState.IDLE if self.state is HostState.ACTIVE else self.state
        self._to_safety(state, request.reason, "safe")
        return {"applied": self._output.applied}

    def _estop(self, request: EstopRequest, now: float) -> dict[str, Any]:
        if request.action == "press":
            self._check_latch(now)
            self._driver.safe()
        else:
            self._latch.release()
            if self.state is HostState.LATCHED:
                self._transition(HostState.IDLE, "the emergency stop was released", "released")
        return {"state": self.state.value, "latched": self._latch.standing is not None}

    def _set(self, payload: SetpointMessage, now: float) -> dict[str, Any]:
        setpoint = Setpoint.of(payload)
        self._admit(setpoint, now)
        self._output.limits.refuse_beyond(setpoint.values)
        self._apply(setpoint, now)
        return {"requested": self._output.requested, "applied": self._output.applied}

    def _follow(self, payload: bytes, now: float) -> dict[str, Any]:
        setpoint = Setpoint.from_bytes(payload)
        if objection := self._lease.objection(setpoint.token, now):
            # setpoints of a second operator must not end the run of the holder: count and ignore them
            self._refusals.note(setpoint_key(self._config.device), objection)
            return {}
        self._admit(setpoint, now)
        self._output.limits.refuse_unusable(setpoint.values)
        self._apply(setpoint, now)
        return {}

    def _admit(self, setpoint: Setpoint, now: float) -> None:
        # a stale setpoint must not renew the lease, so its age is checked first
        age, oldest = setpoint.age(), self._config.watchdog
        if age > oldest:
            self._contact.check_standstill()
            raise CommandRefusedError(f"stale: a setpoint may be {oldest:g} s old, this one is {age:.3g} s")
        if age < -oldest:
            raise CommandRefusedError(f"from the future: the setpoint's clock is {-age:.3g} s ahead of ours")
        if self._latch.standing is not None:
            raise CommandRefusedError(self._latch.standing.describe())
        self._lease.renew(setpoint.token, now)

    def _apply(self, setpoint: Setpoint, now: float) -> None:
        if self.state is not HostState.ACTIVE:
            self._output.begin(now)
            self._transition(HostState.ACTIVE, f"commanded by {self._lease.holder!r}")
        self._output.take(setpoint.values)
        self._commands.put(self._output.send(now, setpoint.t_hw_ns))

    def _check_watchdog(self, now: float, turn: float) -> None:
        if self.state is not HostState.ACTIVE:
            return
        self._output.unheard += min(turn, MAX_TURN)
        if self._output.unheard > self._config.watchdog:
            message = f"watchdog: commands stopped for {self._config.watchdog:g} s"
            if self._contact.explains_pause(now):
                self._is_silent = self._config.reconnect
                self._to_safety(HostState.IDLE, f"{message}, as the device sends no samples", "quiet")
            else:
                self._to_safety(HostState.IDLE, message, "watchdog")
        elif now - self._output.sent_at > self._keep_alive:
            self._commands.put(self._output.send(now))

    def _to_safety(self, state: HostState, reason: str, kind: str | None = None, **more: str) -> None:
        self._output.make_safe()
        self._lease.revoke()
        self._transition(state, reason, kind, **more)

    def _transition(self, state: HostState, reason: str, kind: str | None = None, **more: object) -> None:
        self.state, self._reason = state, reason
        self._announce(kind or state.value, reason, **more)

    def _announce(self, kind: str, message: str, **more: object) -> None:
        data = {"t_ns": unix_ns(), "kind": kind, "state": self.state.value, "message": message, **more}
        publish_event(self._bus, self._config.device, data)
