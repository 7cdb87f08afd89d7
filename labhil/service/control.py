"""The thread that owns a device: what it sends there, what it takes from there, and when it stops it.

All state belongs to one thread, the one in :meth:`DeviceControl.run`. Whatever comes from the bus is put
into its inbox; only ``safe`` and ``estop`` reach past it, since a device must be stopped even when that
thread hangs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from typing import Any, Self

from labhil.bus.ask import Answering, serve
from labhil.bus.authentication import Refusals
from labhil.bus.incoming import AnyRequest, EstopRequest, LeaseRequest, SafeRequest, SetpointMessage
from labhil.bus.keys import command_key, setpoint_key
from labhil.bus.live import announce
from labhil.bus.publish import StreamPublisher, publish_event
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.driver import DeviceInfo, Driver
from labhil.errors import BusError, CommandRefusedError, DeviceError, DeviceSilentError
from labhil.host_clock import SuspendWatch, unix_ns
from labhil.service.commands import COMMANDS, is_guarded, reader_of
from labhil.service.declared import command_stream, stream_metadata
from labhil.service.inbox import Inbox
from labhil.service.interlocks import Interlocks
from labhil.service.latch import HostLatch
from labhil.service.lease import Lease
from labhil.service.limits import SampleLimits
from labhil.service.messages import HostConfig, HostState, Setpoint
from labhil.service.output import Clock, Output
from labhil.service.reconnect import GIVE_UP, Continuation, Search, refuse_another
from labhil.signals import Batch

READ_TIMEOUT, IDLE_TIMEOUT = 0.002, 0.01
"""Longest waits for samples, s, with and without a lease: how late a setpoint or a request is taken up."""
REACTION = 0.25
"""Share of the sample period that the setpoint after a sample is waited for."""
SILENCE = 1.0
"""How long a connected device may say nothing, s of the host's clock."""
LONGEST_STALL = 0.05
"""What one turn of the loop may count for in the watchdog, s: our own stalls are nobody's silence."""

SETPOINTS = 256
"""Streamed setpoints that may wait: behind more, the true ones of a flooded host would come too late."""

STEADY = (HostState.IDLE, HostState.ACTIVE)


class DeviceControl:
    """Runs one connected driver on the bus; a context manager around :meth:`run`.

    ``ended`` is called once per turn and returns why it is time to end, or an empty string.
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
            "setpoint": self._follow,
            "set": self._set,
            "lease": self._take_lease,
            "safe": self._make_safe,
            "estop": self._estop,
            "shutdown": self._shut_down,
            "status": self._status,
        }
        self._shut_down_reason = ""
        self._refused: set[str] = set()
        self._refusals = Refusals(lambda text: self._announce("rejected", text))
        self._violation: str | None = None
        self._heard_at = 0.0
        self._woken_at = -math.inf
        self._heard_any = False
        self._quiet = False
        self._mending = False
        self._unheard = 0
        self._suspends = SuspendWatch()
        self._turned_at = time.monotonic()
        self._continuation = Continuation(spec.stream.rate * info.speed, info.speed)
        self._inbox = Inbox(config.device)
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
            for name in COMMANDS:
                resources.enter_context(self._answering(name))
            setpoints = subscribe(
                bus,
                setpoint_key(config.device),
                self._inbox.put_setpoints,
                self._refusals,
                depth=SETPOINTS,
                commands=True,
            )
            resources.enter_context(setpoints)
            resources.enter_context(announce(bus, config.device))
            self._resources = resources.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def _answering(self, name: str) -> Answering:
        key, handler = command_key(self._config.device, name), self._handler(name)
        guarded, refusals = partial(is_guarded, name), self._refusals
        return serve(self._bus, key, handler, reader=reader_of(name), guarded=guarded, refusals=refusals)

    def run(self) -> str:
        """Serve the device until something ends it, and return what did; the device is safe then.

        Raises what the driver raises; the device is brought to its safe state then, too.
        """
        self._heard_at = self._turned_at = before = time.monotonic()
        try:
            while not (reason := self._ended() or self._shut_down_reason):
                try:
                    now = self._turn(before)
                except DeviceError as error:
                    if not self._config.reconnect:
                        raise
                    self._search_device(error)
                    self._heard_at = now = time.monotonic()
                before = now
        finally:
            self._driver.safe()
        self._transition(HostState.STOPPED, reason, counters=asdict(self._driver.counters))
        return reason

    def _turn(self, before: float) -> float:
        """Take in samples, answer, keep watch; returns when that was. ``before`` is the last turn's time."""
        self._check_bus()
        batch = self._driver.read(READ_TIMEOUT if self._lease.is_held(before) else IDLE_TIMEOUT)
        self._check_standstill()
        now = time.monotonic()
        if len(batch):
            if now - self._heard_at > self._config.watchdog / 2:
                self._woken_at = now
            self._heard_at, self._heard_any = now, True
            self._take_in(self._continuation.carry_on(batch))
            self._look_whether_heard(now)
        elif now - self._heard_at > SILENCE:
            raise DeviceSilentError(
                f"{self._config.address}: the device said nothing for {SILENCE:g} s; "
                f"expected {self._driver.spec.stream.rate * self._info.speed:g} samples per second"
            )
        self._check_latch(now)
        answer_is_due = len(batch) > 0 and self.state is HostState.ACTIVE
        if self._heard_any:  # requests at the very start wait for the first sample, which shows the state
            self._answer_requests(now, self._reaction_time if answer_is_due else 0.0)
        self._check_watchdog(now, now - before)
        return now

    def _check_standstill(self) -> None:
        """Raise DeviceSilentError where the machine was suspended, or this process stood still.

        The device made itself safe meanwhile, and what waits on its wire and on the bus is as old as that.
        A busy machine lets a process stand still, too: that ends no run that does not look for lost devices.
        """
        if (slept := self._suspends.slept()) > SILENCE:
            raise DeviceSilentError(f"{self._config.address}: this machine was suspended for {slept:.3g} s")
        before, self._turned_at = self._turned_at, time.monotonic()
        stood = self._turned_at - before
        if stood > SILENCE and self._config.reconnect:
            raise DeviceSilentError(f"{self._config.address}: its host stood still for {stood:.3g} s")

    def _look_whether_heard(self, now: float) -> None:
        """Note that the device made itself safe, as it no longer heard us, though its samples come in.

        Raises DeviceSilentError where a lost device is looked for: the configuration is sent again then, and
        the device has to confirm it. Else the run goes on, and the output comes from the safe value.
        """
        unheard, self._unheard = self._driver.counters.unheard - self._unheard, self._driver.counters.unheard
        if unheard <= 0 or self.state is not HostState.ACTIVE:
            return
        message = f"{self._config.address}: the device heard no command for so long that it made itself safe"
        if self._config.reconnect:
            raise DeviceSilentError(message)
        self._output.begin_from_safe(now)
        self._announce("unheard", message)

    def _check_bus(self) -> None:
        """Raise BusError where something is heard no more: such a host must not go on commanding."""
        if deaf := self._bus.failure():
            raise BusError(f"the host of {self._config.device!r}: {deaf}")

    def _search_device(self, error: DeviceError) -> None:
        """Try to connect again, and answer meanwhile; raises what the last attempt did."""
        self._to_safety(HostState.RECONNECTING, f"{error}; looking for it again", "lost")
        lost_at = time.monotonic()
        search = Search(self._driver, math.inf if self._config.patient else GIVE_UP)
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
        booted = "the same boot" if same_boot else "it has booted again"
        self._info = info
        self._heard_any, self._quiet, self._unheard = False, False, 0
        self._suspends.slept()
        self._turned_at = time.monotonic()
        self._continuation.tear(same_boot=same_boot)
        gap = time.monotonic() - lost_at
        self._return(f"after {gap:.2f} s the device is back, its configuration sent again: {booted}")

    def _return(self, message: str) -> None:
        state = HostState.IDLE if self._latch.standing is None else HostState.LATCHED
        self._transition(state, message, "reconnected")

    def _check_latch(self, now: float) -> None:
        self._latch.look(now)
        standing = self._latch.standing
        if standing is not None and self.state not in (HostState.LATCHED, HostState.RECONNECTING):
            self._to_safety(HostState.LATCHED, standing.describe(), "estop")

    # what comes from the device

    def _take_in(self, batch: Batch) -> None:
        self._output.clock = Clock(int(batch.t_hw_ns[-1]), int(batch.t_acq_ns[-1]))
        self._states.put(batch)
        beyond = self._sample_limits.violation(batch)
        self._violation = beyond or self._output.fault()
        tripped = self._interlocks.take_in(batch)
        if beyond is None and self._config.reconnect:
            self._wait_for_driver()
        if self._violation is not None and not self._mending and self.state in STEADY:
            self._to_safety(HostState.TRIPPED, self._violation)
        if tripped is not None:
            state = HostState.LATCHED if self.state is HostState.LATCHED else HostState.TRIPPED
            self._to_safety(state, tripped.message, "interlock", then=tripped.then)
        if self._quiet:
            self._quiet = False
            self._return("the device sends samples again")

    def _wait_for_driver(self) -> None:
        """Note that the driver mends something by itself, though samples go on, or that it has."""
        mending = self._violation is not None and self._output.is_transient()
        if mending and not self._mending and self.state in STEADY:
            self._mending = True
            self._to_safety(HostState.IDLE, str(self._violation), "lost")
        elif self._mending and not mending:
            self._mending = False
            if self._violation is None and self.state in STEADY:
                self._return("the device can be commanded again")

    # what comes from the bus, still in the bus's threads

    def _handler(self, name: str) -> Callable[[Any], dict[str, Any]]:
        def handle(payload: Any) -> dict[str, Any]:
            if isinstance(payload, EstopRequest) and payload.action == "press":
                self._latch.press(payload.by, payload.reason)
                self._driver.safe()
            if name == "safe":
                self._driver.safe()
            return self._inbox.ask(name, payload)

        return handle

    # the control thread again

    def _answer_requests(self, now: float, patience: float) -> None:
        """Take what is in the inbox; where nothing is, wait up to ``patience`` s for the first."""
        for request in self._inbox.take(patience):
            try:
                answer = self._answers[request.name](request.payload, now)
            except DeviceSilentError as error:
                if request.answer is not None:
                    request.answer.set_exception(CommandRefusedError(str(error)))
                raise
            except CommandRefusedError as error:
                if request.answer is None:
                    self._check_latch(now)  # a stop that came in with it is announced before the refusal
                    self._refuse_once(str(error))
                else:
                    request.answer.set_exception(error)
            else:
                if request.answer is not None:
                    request.answer.set_result(answer)

    def _refuse_once(self, message: str) -> None:
        if message not in self._refused:
            self._refused.add(message)
            self._announce("refused", message)

    def _shut_down(self, payload: AnyRequest, now: float) -> dict[str, Any]:
        self._shut_down_reason = "told to shut down"
        return self._status(payload, now)

    def _status(self, _payload: AnyRequest, now: float) -> dict[str, Any]:
        return {
            "state": self.state.value,
            "reason": self._reason,
            "holder": self._lease.holder if self._lease.is_held(now) else None,
            "lease_left": self._lease.remaining(now),
            "objection": self._objection(),
            "age": now - self._heard_at,
            "applied": self._output.applied,
            "counters": asdict(self._driver.counters),
            "overflows": self._states.overflows + self._commands.overflows,
            "refused": dict(self._refusals.counts),
        }

    def _take_lease(self, request: LeaseRequest, now: float) -> dict[str, Any]:
        if request.action == "take":
            objection = self._objection()
            if objection is not None:
                raise CommandRefusedError(objection)
            token = self._lease.take(request.holder, now)
            self._refused.clear()
            self._transition(HostState.IDLE, f"lease taken by {request.holder!r}", "leased")
            return {"token": token}
        self._lease.renew(request.token, now)
        if request.action == "return":
            self._to_safety(HostState.IDLE, "lease returned", "returned")
        else:
            self._output.unheard = 0.0
        return {}

    def _objection(self) -> str | None:
        """Return what stands against commanding the device now, None when nothing does."""
        if self._latch.standing is not None:
            return f"{self._latch.standing.describe()}; release it with `labhil estop --release`"
        if self.state is HostState.RECONNECTING:
            return f"the device is not connected: {self._reason}"
        if self._violation is not None:
            return f"the device cannot be commanded: {self._violation}"
        return self._interlocks.standing()

    def _make_safe(self, request: SafeRequest, _now: float) -> dict[str, Any]:
        # a trip, a latch and a lost device persist: a request to be safe lifts none of them
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
            # no fault of who holds it: what a second operator sends must not end the first one's run
            self._refusals.note(setpoint_key(self._config.device), objection)
            return {}
        self._admit(setpoint, now)
        self._output.limits.refuse_unusable(setpoint.values)
        self._apply(setpoint, now)
        return {}

    def _admit(self, setpoint: Setpoint, now: float) -> None:
        # the lease comes first: a stale setpoint must not keep it alive
        # whoever is of no session of ours stamps by the wall clock, which may have been set since ours began
        age = min(unix_ns() - setpoint.t_ns, time.time_ns() - setpoint.t_ns, key=abs) * 1e-9
        oldest = self._config.watchdog
        if age > oldest:
            self._check_standstill()
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
        self._output.unheard += min(turn, LONGEST_STALL)
        if self._output.unheard > self._config.watchdog:
            stopped = f"watchdog: commands stopped for {self._config.watchdog:g} s"
            silent = now - self._heard_at > self._config.watchdog / 2
            if silent or now - self._woken_at < self._config.watchdog:
                # a controller that follows the samples has nothing to say when there are none, and takes a
                # moment when they come again
                self._quiet = self._config.reconnect
                self._to_safety(HostState.IDLE, f"{stopped}, as the device sends no samples", "quiet")
            else:
                self._to_safety(HostState.IDLE, stopped, "watchdog")
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
