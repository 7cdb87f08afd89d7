"""Drivers of UR arms on the network: samples of every controller cycle, and commands by a client process.

Samples are received in ``rtde.py``, the client process is in ``client.py`` and ``motion.py``.
"""

from __future__ import annotations

import contextlib
import math
import select
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar, Self

from labhil.driver import Counters, DeviceInfo, DriverSpec, FoundAddress
from labhil.errors import CommandRefusedError, ConnectError, DeviceResetError, ProtocolError
from labhil.host_clock import unix_ns
from labhil.signals import Batch, Stream
from labhil_ur5.command_ranges import check_commands
from labhil_ur5.dashboard import serial_number
from labhil_ur5.discovery import find_controllers
from labhil_ur5.fault import SAFETY_NORMAL, fault_of
from labhil_ur5.motion import Motion, MotionState
from labhil_ur5.reported_signals import (
    CLIENT,
    COMMAND_TIMEOUT,
    OUTPUTS,
    REPORTED,
    SPEED,
    TARGET,
    TARGET_COLUMNS,
    TIMESTAMP,
)
from labhil_ur5.rtde import ANSWER_TIMEOUT, Receiver
from labhil_ur5.stream_order import row_reader, variable_names

E_SERIES_RATE, CB3_RATE = 500.0, 125.0
WAYPOINT_RATE = 100.0
"""Rate of waypoints, Hz; the client process interpolates between them."""
START_TOLERANCE = 1e-3
"""Largest distance of the arm from the start of a path, rad."""
POLL_PERIOD = 0.05
"""Longest time in which ``read`` notices a ``close`` from another thread, s."""
FIRST_SAMPLE_TIMEOUT = 2.0
RECONNECT_TIMEOUT = 0.3
"""Time for one answer of the controller where a broken connection is made again, s: meanwhile nobody who asks
the device's host is answered."""
CUT_OFF_TIMEOUT = 0.2
"""Time in which a client that cannot reach the controller any more has to end, s."""
RESTART_DELAY = 1.0
"""Time from the loss of the client process to its restart, s."""
PATH_START_TIMEOUT = 0.2
"""Time in which the client has to report the start of a path, s; waypoints are sent meanwhile."""
MAX_OUTAGE = 60.0
"""Time of repeated losses of the client after which the fault is permanent, s."""

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
        approach={TARGET.name: START_TOLERANCE},
        ready={CLIENT.name: float(STATES.index(MotionState.IDLE))},
    )


class Ur5Driver:
    """A UR arm of the e-Series; satisfies :class:`labhil.driver.TimedDriver`.

    Connecting only receives. The first command starts a program on the controller by a client process, which
    is replaced if it dies; samples do not pass through it. The safe state is: stop and hold.

    Args:
        address: IP address or host name of the controller.
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
        self._read_lock = threading.RLock()
        self._loss_reason = ""
        self._last_loss = self._first_loss = 0.0
        self._follows_path = self._is_cut_off = False
        self._path_started_at = -math.inf

    @classmethod
    def find_addresses(cls, search: str | None = None) -> tuple[FoundAddress, ...]:
        """Return the hosts that answer on the RTDE port; see :mod:`labhil_ur5.discovery`."""
        return find_controllers(search)

    def connect(self) -> DeviceInfo:
        """Start receiving from the controller.

        Raises:
            ConnectError: No controller answers.
            ProtocolError: It is no UR controller of this series.
        """
        self.close()
        with self._read_lock:
            self._latest: dict[str, float] = {}
            self._target: list[float] = []
            self._switch_values: dict[str, float] = {}
            self._seq, self._clock_ns, self._acquired_ns = 0, -1, 0
            self._loss_reason = ""
            self.counters = Counters()
            self._closing = False
            self._listen()
            try:
                return self._identify()
            except BaseException:
                self.close()
                raise

    def _listen(self, timeout: float = ANSWER_TIMEOUT) -> None:
        receiver = Receiver(self.address, timeout)
        try:
            self._check_version(*receiver.greet())
            needed, optional = variable_names()
            recipe = receiver.start(needed, optional, self.spec.stream.rate)
        except BaseException:
            receiver.close()
            raise
        self._read_row = row_reader(recipe)
        self._recipe, self._receiver = recipe, receiver

    def _check_version(self, major: int, *_minor: int) -> None:
        if major not in self.majors:
            raise ProtocolError(
                f"{self.address}: expected a controller of software {' or '.join(map(str, self.majors))},"
                f" found {major}: use the plugin {'ur5_cb3' if major == 3 else 'ur5'!r}"
            )

    def _identify(self) -> DeviceInfo:
        assert self._receiver is not None
        first = self.read(FIRST_SAMPLE_TIMEOUT)
        if not len(first):
            raise ConnectError(f"{self.address}: the controller sends no samples")
        booted_at = (first.t_acq_ns[-1] - first.t_hw_ns[-1]) * 1e-9
        return DeviceInfo(
            firmware=".".join(map(str, self._receiver.version)),
            serial=serial_number(self.address),
            boot_id=int(booted_at),
        )

    def read(self, timeout: float) -> Batch:
        """Return the samples received, waiting up to ``timeout`` s for the first; may be empty.

        Raises:
            DeviceResetError: The controller's clock went back.
            ConnectError: The connection broke and could not be made again, or the driver was closed.
        """
        deadline = time.monotonic() + timeout
        rows: list[Row] = []
        with self._read_lock:
            while not rows:
                if self._receiver is None or self._closing:
                    raise ConnectError(f"{self.address}: not connected")
                remaining = max(deadline - time.monotonic(), 0.0)
                waiting = [self._receiver.fileno(), *self._motion.descriptors()]
                select.select(waiting, [], [], min(remaining, POLL_PERIOD))
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
            self._is_cut_off = True  # the device is looked for anew, and soon
            raise
        except ConnectError:
            # a connection that breaks while the controller runs causes a gap only
            self._receiver.close()
            began = time.monotonic()
            try:
                self._listen(RECONNECT_TIMEOUT)
            except ConnectError as error:
                self._is_cut_off = True
                raise ConnectError(
                    f"{self.address}: the RTDE connection broke and could not be made again: {error}"
                ) from error
            self.counters.resyncs += 1
            if self._follows_path and time.monotonic() - began > COMMAND_TIMEOUT / 2:
                self.counters.unheard += 1  # no waypoint went out meanwhile, and the client stops without
                self._is_cut_off = True
            return []

    def _rows(self, payloads: Iterable[bytes]) -> list[Row]:
        rows: list[Row] = []
        for payload in payloads:
            values = self._recipe.unpack(payload)
            t_hw_ns = round(values[self._recipe.slices[TIMESTAMP].start] * 1e9)
            if self._is_new(t_hw_ns):
                row = self._read_row(values)
                row.append(STATES.index(self._motion.state))
                rows.append((self._seq, 0, t_hw_ns, row))
        if rows:
            self._latest = dict(zip(self.spec.stream.columns(), rows[-1][3], strict=True))
        return self._stamp(rows)

    def _stamp(self, rows: list[Row]) -> list[Row]:
        """Estimate the arrival times of samples that were waiting together."""
        now = unix_ns()
        stamped = []
        for seq, _, t_hw_ns, values in rows:
            self._acquired_ns = max(self._acquired_ns, now - (rows[-1][2] - t_hw_ns))
            stamped.append((seq, self._acquired_ns, t_hw_ns, values))
        return stamped

    def _is_new(self, t_hw_ns: int) -> bool:
        """Number a sample by the controller's clock; return False for a repeated one."""
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
        """Return why the arm cannot be commanded, as text; empty when it can."""
        if self._loss_reason:
            return f"the arm's client was lost ({self._loss_reason}); it is started again"
        return fault_of(self._latest, commanded=self._motion.state is not MotionState.NONE)

    def is_transient(self) -> bool:
        """Return whether the fault is a client process that died and is being replaced.

        Where the controller ended the program, perhaps because somebody pressed stop, the fault is permanent.
        """
        return (
            bool(self._loss_reason)
            and self._motion.died
            and self._latest.get("safety_mode") in SAFETY_NORMAL
            and time.monotonic() - self._first_loss < MAX_OUTAGE
        )

    def command(self, values: Mapping[str, float]) -> None:
        """Move to joint angles by moveJ, or set the speed slider or the digital outputs.

        Args:
            values: ``target_q_0`` … ``target_q_5`` in rad, those left out stay; ``target_speed_fraction`` 0
                to 1; ``standard_digital_outputs`` 0 to 255. An empty mapping is a sign of life.

        Raises:
            CommandRefusedError: A name or a value is wrong, or the path is too fast.
        """
        self._command(values, None)

    def command_at(self, values: Mapping[str, float], t_hw_ns: int) -> None:
        """Send the angles as a waypoint of a path, for a time of the device; otherwise like :meth:`command`.

        A path begins at the position of the arm (within ``START_TOLERANCE``), at rest.
        """
        self._command(values, t_hw_ns)

    def _command(self, values: Mapping[str, float], t_hw_ns: int | None) -> None:
        check_commands(values)
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
        if any(column in values for column in TARGET_COLUMNS) or self._follows_path:
            self._command_joints(self._target, t_hw_ns)
        else:
            self._motion.send({"alive": True})

    def _command_joints(self, q: Sequence[float], t_hw_ns: int | None) -> None:
        motion, joints = self._motion, self._joints()
        self._follows_path = t_hw_ns is not None
        at_target = max(abs(a - b) for a, b in zip(q, joints, strict=True)) <= START_TOLERANCE
        is_starting = time.monotonic() - self._path_started_at < PATH_START_TIMEOUT
        if motion.state is MotionState.NONE:
            if not self.fault():
                motion.start()
        elif motion.state is MotionState.IDLE and not at_target and not (is_starting and self._follows_path):
            if t_hw_ns is not None and self._path_started_at > -math.inf:
                # the client has not started the path: its connection is broken, or the machine is too busy
                self._path_started_at = -math.inf
                self.counters.unheard += 1
                self._is_cut_off = True
                return
            if t_hw_ns is not None:
                raise CommandRefusedError(f"{self.address}: the arm does not stand where its path begins")
            motion.move(q)
        elif t_hw_ns is not None and motion.state in (MotionState.IDLE, MotionState.SERVO):
            if not is_starting:
                self._path_started_at = time.monotonic() if motion.state is MotionState.IDLE else -math.inf
            motion.waypoint(t_hw_ns * 1e-9, q, joints)
        else:
            motion.send({"alive": True})

    def _switch(self, values: Mapping[str, float]) -> None:
        changed = {name: value for name, value in values.items() if self._switch_values.get(name) != value}
        if not changed:
            return
        if self._motion.state is MotionState.NONE:
            self._motion.start()
        if self._motion.state is MotionState.STARTING:
            return  # the host repeats its commands
        if SPEED.name in changed:
            self._motion.send({"slider": changed[SPEED.name]})
        if OUTPUTS.name in changed:
            self._motion.send({"outputs": int(changed[OUTPUTS.name])})
        self._switch_values.update(changed)

    def _joints(self) -> list[float]:
        return [self._latest[column] for column in TARGET_COLUMNS]

    def _watch_client(self) -> None:
        reason = self._motion.poll()
        now = time.monotonic()
        if reason:
            if not self._loss_reason:
                self._first_loss = now
            self._loss_reason, self._last_loss = reason, now
            self._switch_values.clear()
            self.counters.resets += 1
        if not self._loss_reason:
            return
        if self._motion.state is MotionState.NONE and now - self._last_loss > RESTART_DELAY:
            if self._latest.get("safety_mode") in SAFETY_NORMAL:
                self._motion.start()
                self._last_loss = now
        elif self._motion.state is MotionState.IDLE:
            self._loss_reason = ""

    def safe(self) -> None:
        """Stop on the path and hold. Never raises."""
        self._follows_path = False
        self._path_started_at = -math.inf
        self._target = []
        with contextlib.suppress(OSError):
            self._motion.stop()

    def close(self) -> None:
        """Stop the arm, end its program and close the connection. May be called again."""
        self._closing = True
        with self._read_lock:
            self._motion.end(CUT_OFF_TIMEOUT if self._is_cut_off else None)
            self._is_cut_off = False
            if self._receiver is not None:
                self._receiver.close()
            self._receiver = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.safe()
        self.close()


class Ur5Cb3Driver(Ur5Driver):
    """A UR arm of the CB3 series, 125 Hz."""

    spec: ClassVar[DriverSpec] = _spec("ur5_cb3", CB3_RATE, "CB3")
    majors: ClassVar[tuple[int, ...]] = (3,)
