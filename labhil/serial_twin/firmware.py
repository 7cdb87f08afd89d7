"""The firmware of a simulated bench, without its wire: messages in, samples out, and a watchdog."""

from __future__ import annotations

import math
import secrets
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from labhil.errors import ProtocolError
from labhil.link import (
    ChannelScale,
    Config,
    Decoder,
    Frame,
    Hello,
    MessageType,
    Samples,
    SetCommand,
    State,
    StateFlag,
    encode,
)
from labhil.version import __version__

COMMAND_TIMEOUT = 0.3
FIRMWARE_VERSION = (0, 1, 0)

Raw = NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Board:
    """The microcontroller of one kind of rig.

    Attributes:
        device: Name of the device.
        channels: Scale of each channel.
        safe: Raw command in the safe state.
        allowed: Returns the raw command that is applied for a requested one.
        sample_rate: Sample rate, Hz of its clock.
        speed: Seconds of its clock per second of the host.
        clock_start: Its clock at boot, s.
        per_frame: Samples per message; 0 sends each as a STATE.
        longest_output: How long an output other than the safe one may last, s.
        patience: Delay up to which a twin catches up, s of the host.
    """

    device: str
    channels: tuple[ChannelScale, ...]
    safe: int
    allowed: Callable[[int], int]
    sample_rate: float
    speed: float = 1.0
    clock_start: float = 0.0
    per_frame: int = 0
    longest_output: float = math.inf
    patience: float = 0.05


class Firmware:
    """One microcontroller; ``receive`` and ``samples`` return the bytes that it sends.

    Times called ``now`` are s of the host's monotonic clock: the watchdog uses that clock, so that a twin at
    ten times the speed does not need ten times the heartbeats. An output's duration is counted in samples.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self.boot(0.0)

    def boot(self, now: float) -> bytes:
        """Start as after power-on, safe and without a configuration; return HELLO."""
        self._boot_id = secrets.randbelow(0xFFFFFFFF) + 1
        self._decoder = Decoder()
        self._sent: Counter[MessageType] = Counter()
        self._n_samples = 0
        self._waiting: list[Raw] = []
        self._timeout = COMMAND_TIMEOUT
        self._longest_output = self.board.longest_output
        self._output_samples = 0
        self._last_message_at = now
        self._flags = StateFlag.SAFE
        self.output = self.board.safe
        self.was_set = False
        return self._hello(0)

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host and return the answer, if there is one."""
        return b"".join(self._dispatch(frame, now) for frame in self._decoder.feed(data))

    def watch(self, now: float) -> None:
        """Go to the safe output where no valid message has come for too long."""
        if now - self._last_message_at > self._timeout:
            self._go_safe()

    def samples(self, rows: Raw) -> list[bytes]:
        """Take samples (n, fitted channels) and return the messages that they complete."""
        self._n_samples += len(rows)
        self._expire(len(rows))
        if self.board.per_frame == 0:
            begin = self._n_samples - len(rows)
            return [self._state_message(begin + k, row) for k, row in enumerate(rows)]
        self._waiting.append(rows)
        waiting = np.concatenate(self._waiting) if len(self._waiting) > 1 else rows
        size = self.board.per_frame
        complete = len(waiting) // size * size
        self._waiting = [waiting[complete:]]
        first = self._n_samples - len(waiting)
        return [self._samples_message(first + k, waiting[k : k + size]) for k in range(0, complete, size)]

    def _state_message(self, number: int, row: Raw) -> bytes:
        state = State(self._flags, tuple(row.tolist()))
        return self._message(MessageType.STATE, state.pack(), number)

    def _samples_message(self, first: int, rows: Raw) -> bytes:
        return self._message(MessageType.SAMPLES, Samples(self._flags, first, rows).pack(), first)

    def _expire(self, count: int) -> None:
        self._output_samples = 0 if self.output == self.board.safe else self._output_samples + count
        if self._output_samples > self._longest_output * self.board.sample_rate:
            self._go_safe()
            self._flags |= StateFlag.EXPIRED

    def _dispatch(self, frame: Frame, now: float) -> bytes:
        try:
            answer = self._execute(frame)
        except ProtocolError:
            return b""
        self._last_message_at = now
        return answer

    def _execute(self, frame: Frame) -> bytes:
        if frame.type == MessageType.SET:
            self._set(SetCommand.unpack(frame.payload))
        elif frame.type == MessageType.SAFE:
            self._flags &= ~StateFlag.EXPIRED
            self._go_safe()
        elif frame.type == MessageType.CONFIG:
            self._configure(Config.unpack(frame.payload))
        elif frame.type == MessageType.HELLO_REQUEST:
            return self._hello(frame.seq)
        return b""

    def _set(self, command: SetCommand) -> None:
        if self._flags & StateFlag.EXPIRED:
            return
        (requested,) = command.raw[:1] or (self.board.safe,)
        self.output = self.board.allowed(requested)
        self._flags &= ~StateFlag.SAFE
        self.was_set = True

    def _configure(self, config: Config) -> None:
        self._timeout = config.command_timeout_ms * 1e-3
        if config.longest_output_s:
            self._longest_output = min(float(config.longest_output_s), self.board.longest_output)
        self._flags |= StateFlag.CONFIGURED

    def _go_safe(self) -> None:
        self.output = self.board.safe
        self._output_samples = 0
        self._flags |= StateFlag.SAFE

    def _hello(self, answers: int) -> bytes:
        hello = Hello(
            answers=answers,
            firmware=FIRMWARE_VERSION,
            device=self.board.device,
            serial="twin",
            boot_id=self._boot_id,
            build_hash=crc32(__version__.encode()),
            sample_rate=self.board.sample_rate,
            speed=self.board.speed,
            channels=self.board.channels,
        )
        return self._message(MessageType.HELLO, hello.pack(), self._n_samples)

    def _message(self, kind: MessageType, payload: bytes, sample: int) -> bytes:
        """Return a message with the time of the sample of that number."""
        t_us = round(self.board.clock_start * 1e6) + round(sample * 1e6 / self.board.sample_rate)
        message = encode(Frame(kind, self._sent[kind], t_us, payload))
        self._sent[kind] += 1
        return message
