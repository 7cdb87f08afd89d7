"""What the microcontroller of a bench does, without its wires: messages in, samples out, a watchdog."""

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
    """What one rig's microcontroller is made for.

    ``safe`` is the raw command in the safe state and ``allowed`` what becomes of one that is asked for;
    ``sample_rate`` in Hz of its clock, which runs at ``speed`` and shows ``clock_start`` s at boot.
    Samples are sent ``per_frame`` at a time, or each as a STATE where that is 0. An output other than
    the safe one lasts ``longest_output`` s at most. A twin of it that falls behind by less than
    ``patience`` s of the host's time catches up.
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
    """One microcontroller; ``receive`` and ``samples`` return the bytes that it puts on the wire.

    Times called ``now`` are seconds of the host's monotonic clock: the watchdog counts those, so
    that a twin at ten times the speed does not need ten times the heartbeats. How long an output has
    lasted is counted in samples.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self.boot(0.0)

    def boot(self, now: float) -> bytes:
        """Start anew, as after power-on: safe, nothing configured; say HELLO."""
        self._boot_id = secrets.randbelow(0xFFFFFFFF) + 1
        self._decoder = Decoder()
        self._sent: Counter[MessageType] = Counter()
        self._taken = 0
        self._waiting: list[Raw] = []
        self._timeout = COMMAND_TIMEOUT
        self._longest = self.board.longest_output
        self._lasted = 0
        self._heard = now
        self._flags = StateFlag.SAFE
        self.output = self.board.safe
        self.was_set = False
        return self._hello(0)

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host; return the answer, if any."""
        return b"".join(self._dispatch(frame, now) for frame in self._decoder.feed(data))

    def watch(self, now: float) -> None:
        """Go to the safe output when the host has been silent for too long."""
        if now - self._heard > self._timeout:
            self._go_safe()

    def samples(self, rows: Raw) -> list[bytes]:
        """Take samples (n, fitted channels) in, and return the messages that they complete."""
        self._taken += len(rows)
        self._expire(len(rows))
        if self.board.per_frame == 0:
            begin = self._taken - len(rows)
            return [self._state(begin + k, row) for k, row in enumerate(rows)]
        self._waiting.append(rows)
        waiting = np.concatenate(self._waiting) if len(self._waiting) > 1 else rows
        size = self.board.per_frame
        complete = len(waiting) // size * size
        self._waiting = [waiting[complete:]]
        first = self._taken - len(waiting)
        return [self._some(first + k, waiting[k : k + size]) for k in range(0, complete, size)]

    def _state(self, number: int, row: Raw) -> bytes:
        state = State(self._flags, tuple(row.tolist()))
        return self._message(MessageType.STATE, state.pack(), number)

    def _some(self, first: int, rows: Raw) -> bytes:
        return self._message(MessageType.SAMPLES, Samples(self._flags, first, rows).pack(), first)

    def _expire(self, count: int) -> None:
        self._lasted = 0 if self.output == self.board.safe else self._lasted + count
        if self._lasted > self._longest * self.board.sample_rate:
            self._go_safe()
            self._flags |= StateFlag.EXPIRED

    def _dispatch(self, frame: Frame, now: float) -> bytes:
        try:
            answer = self._carry_out(frame)
        except ProtocolError:
            return b""
        self._heard = now
        return answer

    def _carry_out(self, frame: Frame) -> bytes:
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
            self._longest = min(float(config.longest_output_s), self.board.longest_output)
        self._flags |= StateFlag.CONFIGURED

    def _go_safe(self) -> None:
        self.output = self.board.safe
        self._lasted = 0
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
        return self._message(MessageType.HELLO, hello.pack(), self._taken)

    def _message(self, kind: MessageType, payload: bytes, sample: int) -> bytes:
        """A message stamped with the time of the sample with that number."""
        t_us = round(self.board.clock_start * 1e6) + round(sample * 1e6 / self.board.sample_rate)
        message = encode(Frame(kind, self._sent[kind], t_us, payload))
        self._sent[kind] += 1
        return message
