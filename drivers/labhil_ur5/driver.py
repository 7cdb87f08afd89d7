"""A UR arm on the network: what it reports at every cycle of its controller, and how it is commanded."""

from __future__ import annotations

import contextlib
import math
import select
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from types import TracebackType
from typing import ClassVar, Self

from labhil.driver import Counters, DeviceInfo, DriverSpec
from labhil.errors import CommandRefusedError, ConnectError, DeviceError, DeviceResetError, ProtocolError
from labhil.host_clock import unix_ns
from labhil.signals import Batch, Stream
from labhil_ur5.dashboard import Dashboard
from labhil_ur5.declared import (
    CLIENT,
    COMMAND_TIMEOUT,
    DIGITAL_OUTPUTS,
    OUTPUTS,
    REPORTED,
    SPEED,
    TARGET,
    TARGET_COLUMNS,
    TIMESTAMP,
)
from labhil_ur5.fault import SAFETY_NORMAL, fault_of
from labhil_ur5.motion import Motion, MotionState
from labhil_ur5.rtde import ANSWER_WITHIN, Receiver
from labhil_ur5.stream_order import in_stream_order, variables

E_SERIES_RATE, CB3_RATE = 500.0, 125.0
WAYPOINT_RATE = 100.0
"""How often the arm gets a waypoint, Hz; in between the client process interpolates."""
LARGEST_ANGLE = math.radians(363.0)
"""How far a joint turns, rad."""
THERE = 1e-3
"""How near the arm must be to where a path begins, rad."""
PATIENCE = 0.05
"""How long (s) ``close`` from another thread waits for ``read`` to notice."""
FIRST_SAMPLE = 2.0
QUICK_ANSWER = 0.3
"""How long the controller may take for one answer where a broken connection is made again, s: meanwhile
nobody who asks the device's host is answered."""
CUT_OFF = 0.2
"""How long a client may take to end that cannot reach the controller any more, s."""
RESTART_AFTER = 1.0
"""How long after the loss of the client process another one is started, s."""
BEGINNING = 0.2
"""How long the client may take to say that it has begun a path, s; waypoints go on meanwhile."""
GIVE_UP = 60.0
"""How long one client after the other may be lost before somebody has to look, s."""

STATES = tuple(MotionState)

Row = tuple[int, int, int, Sequence[float]]


def _spec(name: str, rate: float, series: str) -> DriverSpec:
    return DriverSpec(
        name=name,
        rig="ur5",
        description=f"UR5 on RTDE, {series}: joint angles in, joint states and currents out, {rate:g} Hz",
        stream=Stream("state", (*(item.signal for item in REPORTED), CLIENT), rate),
        commands=(TARGET, SPEED, OUTPUTS),
        safe={},
        command_timeout=COMMAND_TIMEOUT,
        address_help="the controller's IP address or host name",
        waypoint_rate=WAYPOINT_RATE,
        approach={TARGET.name: THERE},
        ready={CLIENT.name: float(STATES.index(MotionState.IDLE))},
    )


class Ur5Driver:
    """A UR arm of the e-Series; satisfies :class:`labhil.driver.TimedDriver`.

    Connecting only listens. The first command takes the arm's program over, in a client process of its
    own that may die and is replaced; samples do not pass through it. Safe is: stop and hold.
    """

    spec: ClassVar[DriverSpec] = _spec("ur5", E_SERIES_RATE, "e-Series")
    majors: ClassVar[tuple[int, ...]] = (5, 10)

    def __init__(self, address: str) -> None:
        self.address = address
        self.counters = Counters()
        self._receiver: Receiver | None = None
        self._motion = Motion(address, self.spec.stream.rate)
        self._closing = False
        # reentrant: a signal handler may close the driver in the middle of a read
        self._reading = threading.RLock()
        self._lost_because = ""
        self._lost_at = self._first_lost_at = 0.0
        self._timed = self._cut_off = False
        self._begun_at = -math.inf

    def connect(self) -> DeviceInfo:
        """Listen to the controller; ConnectError when it is not there, ProtocolError when it is no UR."""
        self.close()
        with self._reading:
            self._latest: dict[str, float] = {}
            self._target: list[float] = []
            self._switched: dict[str, float] = {}
            self._seq, self._clock_ns, self._acquired_ns = 0, -1, 0
            self._lost_because = ""
            self.counters = Counters()
            self._closing = False
            self._listen()
            try:
                return self._introduce()
            except BaseException:
                self.close()
                raise

    def _listen(self, timeout: float = ANSWER_WITHIN) -> None:
        receiver = Receiver(self.address, timeout)
        try:
            self._check_version(*receiver.greet())
            needed, optional = variables()
            recipe = receiver.start(needed, optional, self.spec.stream.rate)
        except BaseException:
            receiver.close()
            raise
        self._take_values = in_stream_order(recipe)
        self._recipe, self._receiver = recipe, receiver

    def _check_version(self, major: int, *_rest: int) -> None:
        if major not in self.majors:
            raise ProtocolError(
                f"{self.address}: expected a controller of software {' or '.join(map(str, self.majors))},"
                f" found {major}: use the plugin {'ur5_cb3' if major == 3 else 'ur5'!r}"
            )

    def _introduce(self) -> DeviceInfo:
        assert self._receiver is not None
        first = self.read(FIRST_SAMPLE)
        if not len(first):
            raise ConnectError(f"{self.address}: the controller sends no samples")
        self._early = first
        booted_at = (first.t_acq_ns[-1] - first.t_hw_ns[-1]) * 1e-9
        return DeviceInfo(
            firmware=".".join(map(str, self._receiver.version)),
            serial=_serial(self.address),
            boot_id=int(booted_at),
        )

    def read(self, timeout: float) -> Batch:
        """Return the samples that have come in, waiting up to ``timeout`` s for the first.

        An empty batch means that nothing came. Raises DeviceResetError when the controller's clock went
        back, ConnectError when the wire is gone (after one attempt to make it again) or the driver closed.
        """
        deadline = time.monotonic() + timeout
        rows: list[Row] = []
        with self._reading:
            while not rows:
                if self._receiver is None or self._closing:
                    raise ConnectError(f"{self.address}: not connected")
                remaining = max(deadline - time.monotonic(), 0.0)
                waiting = [self._receiver.fileno(), *self._motion.descriptors()]
                select.select(waiting, [], [], min(remaining, PATIENCE))
                self._watch_client()
                rows = self._rows(self._payloads())
                if remaining <= 0.0:
                    break
        return Batch.of(rows, self.spec.stream.width)

    def _payloads(self) -> list[bytes]:
        assert self._receiver is not None
        try:
            return self._receiver.packages()
        except ProtocolError:
            self._cut_off = True  # the device is looked for anew, and soon
            raise
        except ConnectError:
            # a connection that breaks while the controller lives leaves a hole and nothing more
            self._receiver.close()
            began = time.monotonic()
            try:
                self._listen(QUICK_ANSWER)
            except ConnectError as error:
                self._cut_off = True
                raise ConnectError(
                    f"{self.address}: the RTDE connection broke and could not be made again: {error}"
                ) from error
            self.counters.resyncs += 1
            if self._timed and time.monotonic() - began > COMMAND_TIMEOUT / 2:
                self.counters.unheard += 1  # no waypoint went out meanwhile, and the client stops without
                self._cut_off = True
            return []

    def _rows(self, payloads: Iterable[bytes]) -> list[Row]:
        rows: list[Row] = []
        for payload in payloads:
            values = self._recipe.unpack(payload)
            t_hw_ns = round(values[self._recipe.slices[TIMESTAMP].start] * 1e9)
            if self._is_new(t_hw_ns):
                row = self._take_values(values)
                row.append(STATES.index(self._motion.state))
                rows.append((self._seq, 0, t_hw_ns, row))
        if rows:
            self._latest = dict(zip(self.spec.stream.columns(), rows[-1][3], strict=True))
        return self._stamp(rows)

    def _stamp(self, rows: list[Row]) -> list[Row]:
        """Give samples that were waiting together the times at which they must have come in."""
        now = unix_ns()
        stamped = []
        for seq, _, t_hw_ns, values in rows:
            self._acquired_ns = max(self._acquired_ns, now - (rows[-1][2] - t_hw_ns))
            stamped.append((seq, self._acquired_ns, t_hw_ns, values))
        return stamped

    def _is_new(self, t_hw_ns: int) -> bool:
        """Number a sample by the controller's clock; False for one that has been seen already."""
        previous_ns, self._clock_ns = self._clock_ns, t_hw_ns
        self.counters.frames += 1
        if previous_ns < 0:
            return True
        if t_hw_ns < previous_ns:
            self.counters.resets += 1
            raise DeviceResetError(
                f"{self.address}: the controller started again in the middle of the run: its clock went"
                f" from {previous_ns * 1e-9:.3f} to {t_hw_ns * 1e-9:.3f} s"
            )
        if t_hw_ns == previous_ns:
            self.counters.stale += 1
            return False
        cycles = max(1, round((t_hw_ns - previous_ns) * 1e-9 * self.spec.stream.rate))
        self.counters.lost += cycles - 1
        self._seq += cycles
        return True

    def fault(self) -> str:
        """Return why the arm cannot be commanded as it is, in words; empty when it can."""
        if self._lost_because:
            return f"the arm's client was lost ({self._lost_because}); it is started again"
        return fault_of(self._latest, commanded=self._motion.state is not MotionState.NONE)

    def is_transient(self) -> bool:
        """Whether the trouble is a client process that died and is being replaced.

        Where the controller ended the program, perhaps because somebody pressed stop, nothing goes on.
        """
        return (
            bool(self._lost_because)
            and self._motion.died
            and self._latest.get("safety_mode") in SAFETY_NORMAL
            and time.monotonic() - self._first_lost_at < GIVE_UP
        )

    def command(self, values: Mapping[str, float]) -> None:
        """Go to joint angles by moveJ, set the speed slider or the digital outputs; empty: a sign of life.

        ``target_q_0`` … ``target_q_5`` in rad, those left out stay; ``target_speed_fraction`` 0 to 1;
        ``standard_digital_outputs`` 0 to 255. CommandRefusedError for anything else.
        """
        self._command(values, None)

    def command_at(self, values: Mapping[str, float], t_hw_ns: int) -> None:
        """As ``command``, but the angles are a waypoint of a path: where to be at a time of the device.

        A path begins where the arm is (within ``THERE``) and at rest.
        """
        self._command(values, t_hw_ns)

    def _command(self, values: Mapping[str, float], t_hw_ns: int | None) -> None:
        _refuse_unusable(values)
        if self._receiver is None:
            raise ConnectError(f"{self.address}: not connected")
        self._switch({name: values[name] for name in (SPEED.name, OUTPUTS.name) if name in values})
        if self._motion.refusal:
            refusal, self._motion.refusal = self._motion.refusal, ""
            raise CommandRefusedError(f"{self.address}: {refusal}")
        if not self._target:
            self._target = self._joints()
        for joint, column in enumerate(TARGET_COLUMNS):
            self._target[joint] = values.get(column, self._target[joint])
        if any(column in values for column in TARGET_COLUMNS) or self._timed:
            self._steer(self._target, t_hw_ns)
        else:
            self._motion.tell({"alive": True})

    def _steer(self, q: Sequence[float], t_hw_ns: int | None) -> None:
        motion, joints = self._motion, self._joints()
        self._timed = t_hw_ns is not None
        at_target = max(abs(a - b) for a, b in zip(q, joints, strict=True)) <= THERE
        begins = time.monotonic() - self._begun_at < BEGINNING
        if motion.state is MotionState.NONE:
            if not self.fault():
                motion.start()
        elif motion.state is MotionState.IDLE and not at_target and not (begins and self._timed):
            if t_hw_ns is not None and self._begun_at > -math.inf:
                # the client has not taken the path up: it hangs on a connection that broke, or has no time
                self._begun_at = -math.inf
                self.counters.unheard += 1
                self._cut_off = True
                return
            if t_hw_ns is not None:
                raise CommandRefusedError(f"{self.address}: the arm does not stand where its path begins")
            motion.move(q)
        elif t_hw_ns is not None and motion.state in (MotionState.IDLE, MotionState.SERVO):
            if not begins:
                self._begun_at = time.monotonic() if motion.state is MotionState.IDLE else -math.inf
            motion.waypoint(t_hw_ns * 1e-9, q, joints)
        else:
            motion.tell({"alive": True})

    def _switch(self, wanted: Mapping[str, float]) -> None:
        changed = {name: value for name, value in wanted.items() if self._switched.get(name) != value}
        if not changed:
            return
        if self._motion.state is MotionState.NONE:
            self._motion.start()
        if self._motion.state is MotionState.STARTING:
            return  # the host says it again
        if SPEED.name in changed:
            self._motion.tell({"slider": changed[SPEED.name]})
        if OUTPUTS.name in changed:
            self._motion.tell({"outputs": int(changed[OUTPUTS.name])})
        self._switched.update(changed)

    def _joints(self) -> list[float]:
        return [self._latest[column] for column in TARGET_COLUMNS]

    def _watch_client(self) -> None:
        why = self._motion.look()
        now = time.monotonic()
        if why:
            if not self._lost_because:
                self._first_lost_at = now
            self._lost_because, self._lost_at = why, now
            self._switched.clear()
            self.counters.resets += 1
        if not self._lost_because:
            return
        if self._motion.state is MotionState.NONE and now - self._lost_at > RESTART_AFTER:
            if self._latest.get("safety_mode") in SAFETY_NORMAL:
                self._motion.start()
                self._lost_at = now
        elif self._motion.state is MotionState.IDLE:
            self._lost_because = ""

    def safe(self) -> None:
        """Stop on the path, and hold; never raises."""
        self._timed = False
        self._begun_at = -math.inf
        self._target = []
        with contextlib.suppress(OSError):
            self._motion.stop()

    def close(self) -> None:
        """Stop the arm, end its program and let go of the wire. Safe to call twice."""
        self._closing = True
        with self._reading:
            if self._cut_off:
                self._motion.end(CUT_OFF)
            else:
                self._motion.end()
            self._cut_off = False
            if self._receiver is not None:
                self._receiver.close()
            self._receiver = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.safe()
        self.close()


class Ur5Cb3Driver(Ur5Driver):
    """An arm of the CB series, 125 Hz; else the same."""

    spec: ClassVar[DriverSpec] = _spec("ur5_cb3", CB3_RATE, "CB3")
    majors: ClassVar[tuple[int, ...]] = (3,)


def _refuse_unusable(values: Mapping[str, float]) -> None:
    ranges = dict.fromkeys(TARGET_COLUMNS, (-LARGEST_ANGLE, LARGEST_ANGLE))
    ranges |= {SPEED.name: (0.0, 1.0), OUTPUTS.name: (0.0, 2.0**DIGITAL_OUTPUTS - 1)}
    for name, value in values.items():
        if name not in ranges:
            raise CommandRefusedError(f"expected one of the commands {', '.join(ranges)}, found {name!r}")
        low, high = ranges[name]
        if not low <= value <= high:
            raise CommandRefusedError(f"{name}: expected {low:g} … {high:g}, found {value:g}")
    if not float(values.get(OUTPUTS.name, 0.0)).is_integer():
        raise CommandRefusedError(f"{OUTPUTS.name}: expected a whole number, found {values[OUTPUTS.name]:g}")


def _serial(host: str) -> str:
    """Ask the dashboard for the serial number; a controller that gives none is "unknown"."""
    try:
        with Dashboard(host) as dashboard:
            number = dashboard.ask("get serial number")
    except DeviceError:
        return "unknown"
    return number if number.isdigit() else "unknown"
