"""What the microcontroller of the bench does, without its wires: messages in, samples out, a watchdog."""

from __future__ import annotations

import math
import secrets
from collections import Counter
from zlib import crc32

from labhil import __version__
from labhil.errors import ProtocolError
from labhil.link import (
    ChannelScale,
    Config,
    Decoder,
    Frame,
    Hello,
    MessageType,
    SetCommand,
    State,
    StateFlag,
    encode,
)

SAMPLE_RATE = 100.0
LEVEL = 15000
"""Pulse width, in 0.1 µs, at which the beam is level."""
QUARTER_TURN = 5000
SERVO = ChannelScale(math.pi / 2 / QUARTER_TURN, LEVEL)
COMMAND_TIMEOUT = 0.3
FIRMWARE_VERSION = (0, 1, 0)


class Firmware:
    """One microcontroller; ``receive`` and ``sample`` return the bytes that it puts on the wire.

    Times called ``now`` are seconds of the host's monotonic clock: the watchdog counts those, so
    that a twin at ten times the speed does not need ten times the heartbeats.
    """

    def __init__(self, position: ChannelScale, speed: float, clock_start: float, pulse_step: int) -> None:
        self._channels = (position, SERVO)
        self._speed = speed
        self._clock_start_us = round(clock_start * 1e6)
        self._pulse_step = pulse_step
        self.boot(0.0)

    def boot(self, now: float) -> bytes:
        """Start anew, as after power-on: level, nothing configured; say HELLO."""
        self._boot_id = secrets.randbelow(0xFFFFFFFF) + 1
        self._decoder = Decoder()
        self._sent: Counter[MessageType] = Counter()
        self._samples = 0
        self._timeout = COMMAND_TIMEOUT
        self._heard = now
        self._flags = StateFlag.SAFE
        self.pulse = LEVEL
        self.was_set = False
        return self._hello(0)

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host; return the answer, if any."""
        return b"".join(self._obey(frame, now) for frame in self._decoder.feed(data))

    def watch(self, now: float) -> None:
        """Go to the safe output when the host has been silent for too long."""
        if now - self._heard > self._timeout:
            self._go_safe()

    def sample(self, count: int, pulse: int) -> bytes:
        """Return the STATE of this moment, of the converter's count and the pulse in effect."""
        message = self._message(MessageType.STATE, State(self._flags, (count, pulse)).pack())
        self._samples += 1
        return message

    def _obey(self, frame: Frame, now: float) -> bytes:
        try:
            answer = self._carry_out(frame)
        except ProtocolError:
            return b""
        self._heard = now
        return answer

    def _carry_out(self, frame: Frame) -> bytes:
        if frame.type == MessageType.SET:
            (wanted,) = SetCommand.unpack(frame.payload).raw[:1] or (LEVEL,)
            steps = round((wanted - LEVEL) / self._pulse_step)
            self.pulse = LEVEL + min(max(steps * self._pulse_step, -QUARTER_TURN), QUARTER_TURN)
            self._flags &= ~StateFlag.SAFE
            self.was_set = True
        elif frame.type == MessageType.SAFE:
            self._go_safe()
        elif frame.type == MessageType.CONFIG:
            self._timeout = Config.unpack(frame.payload).command_timeout_ms * 1e-3
            self._flags |= StateFlag.CONFIGURED
        elif frame.type == MessageType.HELLO_REQUEST:
            return self._hello(frame.seq)
        return b""

    def _go_safe(self) -> None:
        self.pulse = LEVEL
        self._flags |= StateFlag.SAFE

    def _hello(self, answers: int) -> bytes:
        hello = Hello(
            answers=answers,
            firmware=FIRMWARE_VERSION,
            device="ball_beam",
            serial="twin",
            boot_id=self._boot_id,
            build_hash=crc32(__version__.encode()),
            sample_rate=SAMPLE_RATE,
            speed=self._speed,
            channels=self._channels,
        )
        return self._message(MessageType.HELLO, hello.pack())

    def _message(self, kind: MessageType, payload: bytes) -> bytes:
        t_us = self._clock_start_us + round(self._samples * 1e6 / SAMPLE_RATE)
        message = encode(Frame(kind, self._sent[kind], t_us, payload))
        self._sent[kind] += 1
        return message
