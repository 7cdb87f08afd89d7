"""The driver of rigs on the framed serial link; what differs between rigs is in their :class:`SerialRig`."""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from labhil.driver import Counters, DeviceInfo, DriverSpec, FoundAddress
from labhil.errors import (
    CommandRefusedError,
    ConnectError,
    DeviceError,
    DeviceResetError,
    OptionError,
    ProtocolError,
)
from labhil.host_clock import unix_ns
from labhil.link import Decoder, Frame, Hello, MessageType, Samples, SetCommand, State, StateFlag, Unwrapper
from labhil.serial_rig.handshake import Sender, configure, request_hello
from labhil.serial_rig.port import Port, serial_ports
from labhil.serial_rig.rig import Scaler, SerialRig, info_of
from labhil.signals import Batch

MAX_READ_WAIT = 0.05
"""Longest wait of ``read`` for bytes, s, and so of a ``close`` from another thread."""

COMMAND_DELAY = 0.1
"""s after a first command; until then samples from before it may still come in."""

MIN_SILENCE, MAX_FRAME_GAP, MAX_BURST = 0.1, 0.005, 0.03
"""s: after so long a silence bytes that follow within ``MAX_FRAME_GAP`` of one another belong to one queue,
for ``MAX_BURST`` at most."""

MAX_READ_BYTES = 1 << 16
"""Bytes that are taken at once; more than an operating system keeps for a port."""

MAX_DELAY = 10.0
"""s; bytes that waited for longer than that are of a device that was given up, or its clock went astray."""


class SerialDriver:
    """Satisfies :class:`labhil.driver.FaultReportingDriver`; a plugin sets ``rig`` and its ``spec``.

    Opening a port resets an Arduino, so every ``connect`` waits for the device's HELLO and sends the
    configuration again. ``spec`` is then that of the connected device. The device goes to its safe output by
    itself after ``spec.command_timeout`` without a valid message.
    """

    rig: ClassVar[SerialRig]
    spec: DriverSpec

    def __init__(self, address: str) -> None:
        self.address = address
        self.counters = Counters()
        self._port: Port | None = None
        self._closing = False
        # reentrant: a signal handler may close the driver in the middle of a read
        self._reading = threading.RLock()
        self._writing = threading.RLock()
        self._first_command_at: float | None = None
        self._is_commanded = self._has_expired = False
        self._received_at = 0.0

    @classmethod
    def find_addresses(cls, search: str | None = None) -> tuple[FoundAddress, ...]:
        """Return the serial ports of this machine; none is opened, since that resets an Arduino.

        Raises:
            OptionError: A network is to be searched.
        """
        if search is not None:
            raise OptionError(
                "search",
                f": expected none for {cls.spec.name}, which is on a serial port, found {search!r}; a port "
                "server's address is stated as socket://host:port",
            )
        return serial_ports()

    def connect(self) -> DeviceInfo:
        """Open the port, wait for HELLO and send the configuration; the device is in its safe state then.

        Raises:
            ConnectError: The port does not exist, or nothing comes from it.
            ProtocolError: What comes from it is not the protocol, or another device answers.
        """
        self.close()
        with self._reading:
            port = Port(self.address, self.rig.baud_rate)
            try:
                return self._identify(port)
            except BaseException:
                port.close()
                raise

    def _identify(self, port: Port) -> DeviceInfo:
        decoder = Decoder()
        sender = Sender(port, first_seq=1 + secrets.randbelow(0xF000))
        hello = request_hello(port, decoder, sender)
        mismatch = self.rig.mismatch(hello)
        if mismatch:
            raise ProtocolError(f"{self.address}: {mismatch}")
        configure(port, decoder, sender, self.rig.config)
        self.counters = Counters()
        self._failure: DeviceError | None = None
        self._hello = hello
        self._decoder, self._sender = decoder, sender
        self._counts_before = (decoder.frames, decoder.crc_errors, decoder.resyncs)
        self._numbers = {MessageType.STATE: Unwrapper(16), MessageType.SAMPLES: Unwrapper(32)}
        self._clock, self._period_ns = Unwrapper(32), 1e9 / hello.sample_rate
        self._last_seq: int | None = None
        self._acquired_ns = 0
        self._first_command_at, self._is_commanded, self._has_expired = None, False, False
        self._scaler = Scaler(self.rig, hello)
        self._closing = False
        self.spec = self.rig.spec_of(hello)
        self._port = port
        return info_of(hello, self.rig.fitted(hello))

    def read(self, timeout: float) -> Batch:
        """Return the samples that have arrived, in SI units; an empty batch where none have.

        Args:
            timeout: Longest wait for the first sample, s.

        Raises:
            DeviceResetError: The device booted again; earlier samples are returned first.
            ConnectError: The connection is lost, or the driver is closed.
        """
        deadline = time.monotonic() + timeout
        pieces: list[Batch] = []
        with self._reading:
            while not pieces:
                if self._port is None or self._closing:
                    raise ConnectError(f"{self.address}: not connected")
                if self._failure is not None:
                    raise self._failure
                remaining = deadline - time.monotonic()
                data = self._receive(self._port, min(max(remaining, 0.0), MAX_READ_WAIT))
                pieces = self._take(self._decoder.feed(data), unix_ns())
                if remaining <= 0.0 and self._failure is None:
                    break
            self._update_counters()
        return Batch.joined(pieces, self._scaler.width)

    def _receive(self, port: Port, timeout: float) -> bytes:
        """All that has come in; of a queue the last frame is the new one.

        After a silence the first bytes may be the oldest of a queue that follows.
        """
        data = more = port.receive(timeout)
        if data:
            wait = MAX_FRAME_GAP if time.monotonic() - self._received_at > MIN_SILENCE else 0.0
            self._received_at = time.monotonic()
            while more and len(data) < MAX_READ_BYTES and time.monotonic() - self._received_at < MAX_BURST:
                try:
                    more = port.receive(wait)
                except ConnectError:  # the next read says so, once what came before it is taken
                    break
                data += more
        return data

    def _take(self, frames: Sequence[Frame], now_ns: int) -> list[Batch]:
        pieces: list[Batch] = []
        for frame, delay_ns in zip(frames, self._delays_of(frames), strict=True):
            self._acquired_ns = max(self._acquired_ns, now_ns - delay_ns)
            try:
                piece = self._decode_frame(frame, self._acquired_ns)
            except DeviceError as error:
                self._failure = error
                break
            if piece is not None:
                pieces.append(piece)
        return pieces

    def _delays_of(self, frames: Sequence[Frame]) -> list[int]:
        """Time that each of the frames of one read waited on its way, ns of the host.

        The newest frame came in now, and the others before it by the device's clock: what waited in an
        adapter or for a busy machine is older than the newest.
        """
        delays_ns: list[int] = []
        newest: int | None = None
        for frame in reversed(frames):
            if frame.type not in self._numbers:
                newest = None  # a boot: the clock restarts
                delays_ns.append(0)
                continue
            newest = frame.t_us if newest is None else newest
            delay_ns = ((newest - frame.t_us) & 0xFFFFFFFF) / self._hello.speed * 1000
            delays_ns.append(round(delay_ns) if delay_ns < MAX_DELAY * 1e9 else 0)
        return delays_ns[::-1]

    def _decode_frame(self, frame: Frame, t_acq_ns: int) -> Batch | None:
        if frame.type == MessageType.HELLO:
            self._check_boot(Hello.unpack(frame.payload))
            return None
        if frame.type == MessageType.STATE:
            state = State.unpack(frame.payload)
            raw = np.array([state.raw], dtype=np.uint16)
            return self._batch(frame, state.flags, MessageType.STATE, frame.seq, raw, t_acq_ns)
        if frame.type == MessageType.SAMPLES:
            block = Samples.unpack(frame.payload)
            return self._batch(frame, block.flags, MessageType.SAMPLES, block.first, block.raw, t_acq_ns)
        return None

    def _batch(
        self, frame: Frame, flags: int, kind: MessageType, number: int, raw: NDArray[np.uint16], t_acq_ns: int
    ) -> Batch:
        self._check_flags(flags)
        if raw.shape[1] != self._scaler.width:
            raise ProtocolError(
                f"{self.address}: expected samples of {self._scaler.width} channels, found {raw.shape[1]}"
            )
        count = np.arange(len(raw))
        first = self._numbers[kind].unwrap(number)
        if self._last_seq is not None:
            self.counters.lost += max(first - self._last_seq - 1, 0)
        self._last_seq = first + len(raw) - 1
        t_hw_ns = self._clock.unwrap(frame.t_us) * 1000 + np.rint(count * self._period_ns).astype(np.int64)
        return Batch(first + count, np.full(len(raw), t_acq_ns), t_hw_ns, self._scaler.values(raw))

    def _check_flags(self, flags: int) -> None:
        if not flags & StateFlag.CONFIGURED:
            raise self._reset("it has lost its configuration")
        self._has_expired = bool(flags & StateFlag.EXPIRED)
        if flags & StateFlag.SAFE:
            self.counters.unheard += self._is_commanded
            self._is_commanded = False
        elif self._first_command_at is not None and time.monotonic() - self._first_command_at > COMMAND_DELAY:
            self._is_commanded = True

    def _check_boot(self, hello: Hello) -> None:
        if hello.boot_id != self._hello.boot_id:
            raise self._reset(f"expected boot {self._hello.boot_id:08x}, found boot {hello.boot_id:08x}")

    def _reset(self, reason: str) -> DeviceResetError:
        self.counters.resets += 1
        return DeviceResetError(f"{self.address}: the device booted again in the middle of the run: {reason}")

    def _update_counters(self) -> None:
        frames, crc_errors, resyncs = self._counts_before
        self.counters.frames = self._decoder.frames - frames
        self.counters.crc_errors = self._decoder.crc_errors - crc_errors
        self.counters.resyncs = self._decoder.resyncs - resyncs

    def command(self, values: Mapping[str, float]) -> None:
        """Send a value for each of ``spec.commands``, or a heartbeat.

        Args:
            values: SI values by name; empty for a heartbeat.

        Raises:
            CommandRefusedError: A name is unknown, or a value is not finite or out of range; nothing is sent.
            ConnectError: The connection is lost.
        """
        for name, value in values.items():
            self._check_command(name, value)
        with self._writing:
            if self._port is None:
                raise ConnectError(f"{self.address}: not connected")
            if not values:
                self._sender.send(MessageType.HEARTBEAT)
                return
            scales = self.rig.command_scales(self._hello)
            names = [command.name for command in self.spec.commands]
            raw = tuple(scale.raw(values[name]) for name, scale in zip(names, scales, strict=True))
            self._sender.send(MessageType.SET, SetCommand(raw).pack())
            if self._first_command_at is None:
                self._first_command_at = time.monotonic()

    def _check_command(self, name: str, value: float) -> None:
        if name not in self.spec.ranges:
            expected = ", ".join(repr(known) for known in self.spec.ranges)
            raise CommandRefusedError(f"expected the command {expected}, found {name!r}")
        low, high = self.spec.ranges[name]
        if not low <= value <= high:
            unit = next(signal.unit for signal in self.spec.commands if signal.name == name)
            raise CommandRefusedError(f"{name}: expected {low:g} … {high:g} {unit}, found {value:g}")

    def fault(self) -> str:
        """Return that the device ended an output that lasted too long, until it was made safe; else empty."""
        if not self._has_expired:
            return ""
        return (
            f"{self.address}: expected an output of {self.spec.longest_output:g} s at most without a break, "
            "found that it lasted longer: the device has ended it"
        )

    def is_transient(self) -> bool:
        """Whether the fault passes by itself: an output that lasted too long is for somebody to look at."""
        return False

    def safe(self) -> None:
        """Bring the device to its safe output, until the next command; never raises."""
        with self._writing, contextlib.suppress(DeviceError):
            self._first_command_at, self._is_commanded = None, False
            if self._port is not None:
                self._sender.send(MessageType.SAFE)

    def close(self) -> None:
        """Close the port; the device goes to its safe output by itself. Safe to call twice."""
        self._closing = True
        with self._reading, self._writing:
            if self._port is not None:
                self._port.close()
            self._port = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.safe()
        self.close()
