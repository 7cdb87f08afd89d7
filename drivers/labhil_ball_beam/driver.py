"""The ball-and-beam bench on its serial line."""

from __future__ import annotations

import contextlib
import math
import secrets
import threading
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import ClassVar, Self

from labhil.driver import Counters, DeviceInfo, DriverSpec
from labhil.errors import CommandRefusedError, ConnectError, DeviceError, DeviceResetError, ProtocolError
from labhil.kinds import BALL_BEAM
from labhil.link import Decoder, Frame, Hello, MessageType, SetCommand, State, StateFlag, Unwrapper
from labhil.signals import Batch, Stream
from labhil_ball_beam.handshake import Sender, ask_hello, configure
from labhil_ball_beam.port import Port

POSITION = BALL_BEAM.outputs[0]
SERVO = BALL_BEAM.inputs[0]
LARGEST_ANGLE = math.pi / 2
"""How far the servo turns, rad."""
PATIENCE = 0.05
"""How long (s) ``close`` from another thread waits for ``read`` to notice."""

Row = tuple[int, int, int, Sequence[float]]


class BallBeamDriver:
    """Servo angle out, ball position in, 100 Hz; satisfies :class:`labhil.driver.Driver`.

    Opening a port resets an Arduino, so every ``connect`` waits for the device's HELLO and sends the
    configuration again. The device goes level by itself after ``spec.command_timeout`` without a
    valid message.
    """

    spec: ClassVar[DriverSpec] = DriverSpec(
        name="ball_beam",
        rig="ball_beam",
        description="ball and beam on a serial line: servo angle in, ball position out, 100 Hz",
        stream=Stream("state", (POSITION, SERVO), 100.0),
        commands=(SERVO,),
        safe={SERVO.name: 0.0},
        command_timeout=0.3,
        address_help="/dev/ttyACM0, socket://host:port, rfc2217://host:port",
    )

    def __init__(self, address: str) -> None:
        self.address = address
        self.counters = Counters()
        self._port: Port | None = None
        self._closing = False
        # reentrant: a signal handler may close the driver in the middle of a read
        self._reading = threading.RLock()
        self._writing = threading.RLock()

    def connect(self) -> DeviceInfo:
        """Open the port, wait for HELLO, send the configuration; the device is in its safe state then.

        ConnectError when the port is not there or silent; ProtocolError when what comes from it is
        not the protocol, or another device.
        """
        self.close()
        with self._reading:
            port = Port(self.address)
            try:
                return self._introduce(port)
            except BaseException:
                port.close()
                raise

    def _introduce(self, port: Port) -> DeviceInfo:
        decoder = Decoder()
        sender = Sender(port, first_seq=1 + secrets.randbelow(0xF000))
        hello = ask_hello(port, decoder, sender)
        self._check(hello)
        configure(port, decoder, sender, self.spec.command_timeout)
        self.counters = Counters()
        self._failure: DeviceError | None = None
        self._hello = hello
        self._decoder, self._sender = decoder, sender
        self._before = (decoder.frames, decoder.crc_errors, decoder.resyncs)
        self._seq, self._clock = Unwrapper(16), Unwrapper(32)
        self._last_seq: int | None = None
        self._closing = False
        self._port = port
        return _info(hello)

    def _check(self, hello: Hello) -> None:
        if hello.device != self.spec.name:
            raise ProtocolError(
                f"{self.address}: expected the device 'ball_beam', found {hello.device!r}: wrong port?"
            )
        if len(hello.channels) != len(self.spec.stream.signals):
            raise ProtocolError(
                f"{self.address}: expected 2 channels (position, servo), found {len(hello.channels)}"
            )

    def read(self, timeout: float) -> Batch:
        """Return the samples that have come in, waiting up to ``timeout`` s for the first.

        Position in m, servo angle in effect in rad. An empty batch means that nothing came. Raises
        DeviceResetError when the device booted again (after the samples from before have been
        returned) and ConnectError when the wire is gone or the driver is closed.
        """
        deadline = time.monotonic() + timeout
        rows: list[Row] = []
        with self._reading:
            while not rows:
                if self._port is None or self._closing:
                    raise ConnectError(f"{self.address}: not connected")
                if self._failure is not None:
                    raise self._failure
                left = deadline - time.monotonic()
                data = self._port.receive(min(max(left, 0.0), PATIENCE))
                rows = self._take(self._decoder.feed(data), time.time_ns())
                if left <= 0.0 and self._failure is None:
                    break
            self._count()
        return Batch.of(rows, self.spec.stream.width)

    def _take(self, frames: Sequence[Frame], t_acq_ns: int) -> list[Row]:
        rows: list[Row] = []
        for frame in frames:
            try:
                row = self._row(frame, t_acq_ns)
            except DeviceError as error:
                self._failure = error
                break
            if row is not None:
                rows.append(row)
        return rows

    def _row(self, frame: Frame, t_acq_ns: int) -> Row | None:
        if frame.type == MessageType.HELLO:
            self._check_boot(Hello.unpack(frame.payload))
            return None
        if frame.type != MessageType.STATE:
            return None
        state = State.unpack(frame.payload)
        if not state.flags & StateFlag.CONFIGURED:
            raise self._reset("it has lost its configuration")
        if len(state.raw) != len(self._hello.channels):
            raise ProtocolError(f"{self.address}: expected samples of 2 channels, found {len(state.raw)}")
        seq = self._seq.unwrap(frame.seq)
        if self._last_seq is not None:
            self.counters.lost += max(seq - self._last_seq - 1, 0)
        self._last_seq = seq
        values = [channel.value(raw) for channel, raw in zip(self._hello.channels, state.raw, strict=True)]
        return seq, t_acq_ns, self._clock.unwrap(frame.t_us) * 1000, values

    def _check_boot(self, hello: Hello) -> None:
        if hello.boot_id != self._hello.boot_id:
            raise self._reset(f"expected boot {self._hello.boot_id:08x}, found boot {hello.boot_id:08x}")

    def _reset(self, found: str) -> DeviceResetError:
        self.counters.resets += 1
        return DeviceResetError(f"{self.address}: the device booted again in the middle of the run: {found}")

    def _count(self) -> None:
        frames, crc_errors, resyncs = self._before
        self.counters.frames = self._decoder.frames - frames
        self.counters.crc_errors = self._decoder.crc_errors - crc_errors
        self.counters.resyncs = self._decoder.resyncs - resyncs

    def command(self, values: Mapping[str, float]) -> None:
        """Send a new ``servo_angle`` (rad); with no values at all, a heartbeat.

        CommandRefusedError for another name, a value that is not finite or beyond ±π/2: nothing is
        sent then. ConnectError when the wire is gone.
        """
        for name, value in values.items():
            if name != SERVO.name:
                raise CommandRefusedError(f"expected the command 'servo_angle', found {name!r}")
            if not abs(value) <= LARGEST_ANGLE:
                raise CommandRefusedError(f"servo_angle: expected −π/2 … π/2 rad, found {value:g}")
        with self._writing:
            if self._port is None:
                raise ConnectError(f"{self.address}: not connected")
            if values:
                raw = self._hello.channels[1].raw(values[SERVO.name])
                self._sender.send(MessageType.SET, SetCommand((raw,)).pack())
            else:
                self._sender.send(MessageType.HEARTBEAT)

    def safe(self) -> None:
        """Tell the device to go level and stay there until the next command; never raises."""
        with self._writing, contextlib.suppress(DeviceError):
            if self._port is not None:
                self._sender.send(MessageType.SAFE)

    def close(self) -> None:
        """Let go of the port; the device goes level by itself. Safe to call twice."""
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


def _info(hello: Hello) -> DeviceInfo:
    position, servo = hello.channels
    return DeviceInfo(
        firmware=".".join(str(part) for part in hello.firmware) + f"+{hello.build_hash:08x}",
        serial=hello.serial,
        boot_id=hello.boot_id,
        speed=hello.speed,
        calibration={
            "sample_rate": hello.sample_rate,
            "speed": hello.speed,
            "position_scale": position.scale,
            "position_offset": -position.zero * position.scale,
            "servo_scale": servo.scale,
            "servo_offset": -servo.zero * servo.scale,
        },
    )
