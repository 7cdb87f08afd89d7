"""One device of a run: its samples advance the clock of its steps and are answered with setpoints.

``devices.py`` holds all devices of a run; the controller and the clock are in ``controller.py`` and
``step_clock.py``.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import numpy as np
import zenoh

from labhil.bus.ask import ask
from labhil.bus.authentication import Refusals
from labhil.bus.incoming import EventMessage, parse
from labhil.bus.keys import command_key, event_key, setpoint_key, stream_key
from labhil.bus.session import Bus
from labhil.bus.subscribe import Subscription, subscribe
from labhil.codec import Codec
from labhil.errors import (
    BusError,
    CommandRefusedError,
    EmergencyStopError,
    InterlockError,
    LabhilError,
    LimitTrippedError,
    RunError,
    RunStoppedError,
    WatchdogError,
)
from labhil.experiment.approach import Approach, Waypoints
from labhil.experiment.checks import CheckSection, CheckWatch
from labhil.experiment.controller import Controller
from labhil.experiment.plan import DevicePlan
from labhil.experiment.step_clock import StepClock
from labhil.host_clock import unix_ns
from labhil.service.hosts import ConnectedDevice
from labhil.service.messages import WATCHDOG, Setpoint
from labhil.signals import Batch

HOST_DISCOVERY_TIMEOUT = 10.0
"""How long the bus may take to find a host that has reported ready, s."""

ANSWER_TIMEOUT = 2.0
"""How long a host may take to answer, s."""

QUEUE_DEPTH = 2048
"""Messages of a device that may wait: 0.2 s at 10 kHz. A flood of messages delays them by as many."""

MAX_START_AGE = WATCHDOG
"""s; steps begin at a sample that is not older than this: what waited on a wire or on a busy machine is not
where the device is now."""

ALWAYS: Mapping[str, type[LabhilError]] = {"estop": EmergencyStopError}
UNLESS_PAUSED: Mapping[str, type[LabhilError]] = {"tripped": LimitTrippedError, "interlock": InterlockError}
WHILE_RUNNING: Mapping[str, tuple[type[LabhilError], str]] = {
    "watchdog": (WatchdogError, ""),
    "refused": (RunError, " (a setpoint was refused)"),
    "safe": (RunStoppedError, " (somebody else stopped the device)"),
}
"""The error that ends a run, by the kind of an event of the host."""


class DeviceRun:
    """Commands one device through its steps, at each of its samples, in the time of its clock.

    Between :meth:`start` and the end of its steps every batch of samples is answered with a setpoint.

    Args:
        bus: The bus of the run.
        plan: The device with its steps.
        device: What its host reported.
        duration: Duration of the steps of all devices, s of the device's clock.
        changed: Is set when the steps are over or something failed.
        refusals: Counts messages that are not authentic.
    """

    def __init__(
        self,
        bus: Bus,
        plan: DevicePlan,
        device: ConnectedDevice,
        duration: float,
        changed: threading.Event,
        refusals: Refusals,
    ) -> None:
        self.plan = plan
        self.speed = device.speed
        self.error: LabhilError | None = None
        self.pause_reason = ""
        """Why the device cannot follow its steps for now, though nothing has failed; empty when it can.

        It stays until the run has made the device safe: a device that was silent for a moment may be back
        before the run has noticed, and its steps have to be started again all the same.
        """
        self.resumes_alone = False
        """Whether its host will announce that it is ready again; otherwise an operator has to resume."""
        self.last_sample_at = time.monotonic()
        """When its newest samples came, s of the monotonic clock."""
        self.host_failed = False
        """Whether its host has reported a failure; the host gives the reason when it ends."""
        self._bus, self._duration, self._changed = bus, duration, changed
        self._refusals = refusals
        self._codec = Codec(device.stream)
        self._newest_ns = np.iinfo(np.int64).min
        self._controller = Controller(plan.steps, device.stream, device.safe)
        self._approach = Approach(plan.spec, device.stream)
        self._waypoints = Waypoints(plan.spec.waypoint_rate)
        self._columns = device.stream.columns()
        self.clock = StepClock(plan.steps, self._columns)
        self.newest: Mapping[str, float] = {}
        """The values of the newest sample, by the name of their column."""
        self._watches: tuple[CheckWatch, ...] = ()
        self._since_ns = 0
        self._is_paused = self._is_pause_handled = self._is_back = False
        self._silence_message = ""
        self._running = False
        self._token = ""
        self._setpoint_key = setpoint_key(plan.name)
        self._setpoints = bus.session.declare_publisher(
            self._setpoint_key, congestion_control=zenoh.CongestionControl.BLOCK
        )
        self._subscriptions: list[Subscription] = []
        self._resources = ExitStack()
        self._stream_name = device.stream.name

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            name = self.plan.name
            self._subscriptions = [
                resources.enter_context(subscribe(self._bus, key, take, self._refusals, depth=QUEUE_DEPTH))
                for key, take in (
                    (event_key(name), self._take_events),
                    (stream_key(name, self._stream_name), self._take_samples),
                )
            ]
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._running = False
        self._resources.close()

    @property
    def elapsed(self) -> float:
        """How far the steps have come, s of the device's clock."""
        return self.clock.elapsed

    @property
    def done(self) -> bool:
        """Whether all steps of the run are over by this device's clock."""
        return self.elapsed >= self._duration

    def failure(self) -> Exception | None:
        """Return what failed in the device or in following it; None while nothing has."""
        if self.error is not None:
            return self.error
        for subscription in self._subscriptions:
            if isinstance(subscription.error, LabhilError):
                return subscription.error
            if fault := subscription.failure():
                return BusError(f"the run no longer hears {self.plan.name}: {fault}")
        return None

    def take_lease(self, holder: str) -> None:
        """Take the lease on the device; CommandRefusedError where the host does not give it."""
        answer = ask(
            self._bus,
            command_key(self.plan.name, "lease"),
            {"action": "take", "holder": holder},
            ANSWER_TIMEOUT,
            patience=HOST_DISCOVERY_TIMEOUT,
        )
        self._token = str(answer["token"])

    def start(self) -> None:
        """Let the steps begin or continue at the device's next sample."""
        self.last_sample_at = time.monotonic()
        self._controller.reset_derivatives()
        self._since_ns = unix_ns()
        self.clock.halt()  # however long the pause was, the steps continue where they were
        self.pause_reason, self.resumes_alone = "", False
        self._silence_message = ""
        self._approach.reset()
        self._waypoints.reset()
        self._is_paused = self._is_pause_handled = self._is_back = False
        self._running = True

    def watch(self, checks: Sequence[CheckSection]) -> None:
        """Watch from now on whether the conditions of these checks hold."""
        self._watches = tuple(CheckWatch(check, self._columns) for check in checks)

    def checks_hold(self) -> bool:
        """Return whether all conditions have held; ConditionError for one whose time is over."""
        for watch in self._watches:
            if watch.error is not None:
                raise watch.error
        return all(watch.has_held for watch in self._watches)

    def make_safe(self, reason: str) -> None:
        """Bring the device to its safe state; BusError where its host does not answer."""
        self._running = False
        self._is_paused = self._is_pause_handled = True
        if self._is_back:
            self.pause_reason = ""
        ask(self._bus, command_key(self.plan.name, "safe"), {"reason": reason}, ANSWER_TIMEOUT)

    def _decode_own(self, key: str, payloads: list[bytes]) -> Batch | None:
        """Decode the samples that belong to this device and are new; None where there are none."""
        own_payloads = [payload for payload in payloads if self._codec.is_own(payload)]
        if len(own_payloads) < len(payloads):
            self._refusals.note(
                key, f"{len(payloads) - len(own_payloads)} messages are no samples of this device"
            )
        if not own_payloads:
            return None
        batch = self._codec.decode(own_payloads)
        # the device's clock only advances: an older sample is a copy and would set the steps back
        latest = np.maximum.accumulate(np.concatenate([[self._newest_ns], batch.t_hw_ns]))
        new = batch.t_hw_ns > latest[:-1]
        if not new.all():
            self._refusals.note(key, f"{np.count_nonzero(~new)} samples are older than one that came before")
            batch = Batch(batch.seq[new], batch.t_acq_ns[new], batch.t_hw_ns[new], batch.values[new])
        self._newest_ns = int(latest[-1])
        return batch if len(batch) else None

    def _take_samples(self, key: str, payloads: list[bytes]) -> None:
        batch = self._decode_own(key, payloads)
        if batch is None:
            return
        self.last_sample_at = time.monotonic()
        self.newest = dict(zip(self._columns, batch.values[-1].tolist(), strict=True))
        samples = list(zip(batch.t_hw_ns.tolist(), batch.values.tolist(), strict=True))
        for watch in self._watches:
            for t_ns, values in samples:
                watch.take(t_ns, values)
        if self._running:
            self._follow_steps(samples, unix_ns() - int(batch.t_acq_ns[-1]))

    def _follow_steps(self, samples: Sequence[tuple[int, Sequence[float]]], age_ns: int) -> None:
        """Answer samples with a setpoint; the newest of them was acquired ``age_ns`` ago."""
        setpoints: dict[str, float] = {}
        t_hw_ns: int | None = None
        newest_ns = samples[-1][0]
        for t_ns, values in samples:
            if not self.clock.is_started:
                setpoints = self._controller.setpoints(self.elapsed, values)
                has_arrived = self._approach.has_arrived(setpoints, values)
                # the steps begin at the newest sample, where the first setpoint can act: on a busy machine
                # as many samples may have waited as a step is long, and it would be over before that
                if not has_arrived or t_ns < newest_ns or age_ns > MAX_START_AGE * 1e9:
                    continue
                self.clock.start(t_ns)
                if self._waypoints.rate:
                    # a path begins where the device is, also in the middle of the steps
                    self._put(setpoints, t_ns)
            t_hw_ns = t_ns
            if self.clock.advance(t_ns, values):
                self._controller.reset_derivatives()
            setpoints = self._controller.setpoints(self.elapsed, values, waiting=self.clock.is_waiting)
        if self.clock.notes:
            self._changed.set()
        if self.done:
            self._running = False
            self._changed.set()
        elif self._waypoints.is_due(newest_ns):
            self._put(setpoints, t_hw_ns if self._waypoints.rate else None)

    def _put(self, setpoints: Mapping[str, float], t_hw_ns: int | None) -> None:
        setpoint = Setpoint(self._token, unix_ns(), dict(setpoints), t_hw_ns)
        payload = setpoint.to_bytes()
        self._setpoints.put(payload, attachment=self._bus.sign(self._setpoint_key, payload))

    def _take_events(self, key: str, payloads: list[bytes]) -> None:
        for payload in payloads:
            try:
                self._take_event(parse(EventMessage, payload, "an event"))
            except CommandRefusedError as error:
                self._refusals.note(key, str(error))

    def _take_event(self, event: EventMessage) -> None:
        if event.t_ns < self._since_ns:
            return  # it is older than the last start of the steps
        self.host_failed = self.host_failed or event.kind == "failed"
        message = f"{self.plan.name}: {event.message}"
        if self._note_pause(event, message):
            self._changed.set()
            return
        error = self._error_of(event.kind, message)
        if error is not None and self.error is None:
            self.error = error
            self._changed.set()

    def _note_pause(self, event: EventMessage, message: str) -> bool:
        """Note a device that was lost or is back, or an interlock that pauses the run; whether it was one."""
        kind = event.kind
        if kind == "reconnected":
            self._is_back = self.resumes_alone
            if self._is_back and self._is_pause_handled:
                self.pause_reason = ""
            return True
        is_lost = kind in ("lost", "quiet") and self.plan.section.reconnect
        if not is_lost and not (kind == "interlock" and event.then == "pause"):
            return False
        if not self._running and not self._is_paused:
            return False  # not started, or done
        self._running, self._is_paused, self._is_back = False, True, False
        self.pause_reason, self.resumes_alone = message, is_lost
        return True

    def _error_of(self, kind: str, message: str) -> LabhilError | None:
        if kind in ALWAYS:
            return ALWAYS[kind](message)
        if self._is_paused:
            return None  # the device is in its safe state, and the next request for the lease gets the reason
        if kind in UNLESS_PAUSED:
            return UNLESS_PAUSED[kind](message)
        if self._running and kind == "quiet":
            # silent for good or only late: the host reports it, or refuses the next setpoint
            self._silence_message = message
        if self._running and kind in WHILE_RUNNING:
            error, note = WHILE_RUNNING[kind]
            if kind == "refused" and self._silence_message:
                advice = "`reconnect = true` lets a run wait"
                return RunError(f"{self._silence_message}, and then did again: {advice}")
            return error(f"{message}{note}")
        return None
