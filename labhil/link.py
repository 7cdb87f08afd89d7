"""The framed serial protocol that the small rigs speak (ball and beam, solenoid, DC motor).

A frame on the wire is ``COBS(version | type | seq | t_us | payload | crc) 0x00``, all numbers little-endian:

====== ===== ====================================================================================
bytes  field meaning
====== ===== ====================================================================================
0      u8    version of the protocol, 1
1      u8    message type, see :class:`MessageType`
2–3    u16   seq: counts the messages of this type that the sender has sent since it booted; wraps
4–7    u32   t_us: the sender's clock in µs; wraps after 71.6 min
8–     –     payload, see the message's class
last 2 u16   CRC-16/CCITT-FALSE over everything before it
====== ===== ====================================================================================

The layouts are repeated in the firmware; ``tests/wire/golden_frames.json`` holds both sides to them.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from dataclasses import dataclass
from enum import IntEnum, IntFlag

import numpy as np
from cobs import cobs
from numpy.typing import NDArray

from labhil.errors import ProtocolError

PROTOCOL_VERSION = 1
DELIMITER = b"\x00"
LONGEST_FRAME = 254
"""Longest frame in bytes between two delimiters; more than that without one is garbage."""

_HEADER = struct.Struct("<BBHI")
_CRC = struct.Struct("<H")
_HELLO = struct.Struct("<HBBB16s16sIIffB")
_CHANNEL = struct.Struct("<ff")
_CONFIG = struct.Struct("<H")
_LONGEST_OUTPUT = struct.Struct("<H")
_SAMPLES = struct.Struct("<BBI")


class MessageType(IntEnum):
    """What a frame says. The device sends HELLO and STATE, the host all others."""

    HELLO = 1
    """Who the device is, and its calibration: at boot, and as the answer to HELLO_REQUEST."""
    STATE = 2
    """One sample."""
    SET = 3
    """New values for the commands."""
    HEARTBEAT = 4
    """Nothing but a sign of life; any other valid message is one too."""
    SAFE = 5
    """Go to the safe output and stay there until the next SET."""
    HELLO_REQUEST = 6
    """Say HELLO."""
    CONFIG = 7
    """The host's configuration, sent after every HELLO."""
    SAMPLES = 8
    """Several samples in a row, from a device that samples faster than frames are worth sending."""


class StateFlag(IntFlag):
    """What a device says of itself with every sample."""

    CONFIGURED = 1
    """It has received CONFIG since it booted."""
    SAFE = 2
    """Its output is the safe one: by command, by the host's silence, or because nothing was set yet."""
    EXPIRED = 4
    """Its output lasted longer than is allowed: it is the safe one, and SET does nothing until SAFE."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One message as it stands on the wire; ``type`` may be one that this version does not know."""

    type: int
    seq: int
    t_us: int
    payload: bytes = b""


@dataclass(frozen=True, slots=True)
class ChannelScale:
    """What a raw number means: value (SI) = (raw − ``zero``) · ``scale``; a scale of 0: not fitted."""

    scale: float
    zero: float

    @property
    def fitted(self) -> bool:
        """Whether the device has this channel at all; one that it has not stands in no sample."""
        return self.scale != 0.0

    def value(self, raw: int) -> float:
        """Return the value (SI) of a raw number."""
        return (raw - self.zero) * self.scale

    def raw(self, value: float) -> int:
        """Return the nearest raw number (u16) to a value (SI)."""
        return min(max(round(value / self.scale + self.zero), 0), 0xFFFF)


@dataclass(frozen=True, slots=True)
class Hello:
    """Payload of HELLO.

    ``answers`` is the seq of the HELLO_REQUEST that it answers, or 0 at boot; ``device`` and
    ``serial`` have at most 16 ASCII characters; ``sample_rate`` in Hz of the device's clock;
    ``speed`` is how many seconds of that clock pass in one second (1 on hardware). ``channels``
    gives the meaning of the raw numbers in STATE, in order.
    """

    answers: int
    firmware: tuple[int, int, int]
    device: str
    serial: str
    boot_id: int
    build_hash: int
    sample_rate: float
    speed: float
    channels: tuple[ChannelScale, ...]

    def pack(self) -> bytes:
        """Return the payload's bytes."""
        head = _HELLO.pack(
            self.answers,
            *self.firmware,
            self.device.encode("ascii"),
            self.serial.encode("ascii"),
            self.boot_id,
            self.build_hash,
            self.sample_rate,
            self.speed,
            len(self.channels),
        )
        return head + b"".join(_CHANNEL.pack(channel.scale, channel.zero) for channel in self.channels)

    @classmethod
    def unpack(cls, payload: bytes) -> Hello:
        """Read a payload; ProtocolError when its length is not that of a HELLO."""
        if (
            len(payload) < _HELLO.size
            or len(payload) != _HELLO.size + payload[_HELLO.size - 1] * _CHANNEL.size
        ):
            raise _wrong_length("HELLO", f"{_HELLO.size} and {_CHANNEL.size} for each channel", payload)
        fields = _HELLO.unpack_from(payload)
        answers, major, minor, patch, device, serial, boot_id, build_hash, sample_rate, speed, _ = fields
        pairs = _CHANNEL.iter_unpack(payload[_HELLO.size :])
        return cls(
            answers=answers,
            firmware=(major, minor, patch),
            device=_text(device),
            serial=_text(serial),
            boot_id=boot_id,
            build_hash=build_hash,
            sample_rate=_shortest(sample_rate),
            speed=_shortest(speed),
            channels=tuple(ChannelScale(_shortest(scale), _shortest(zero)) for scale, zero in pairs),
        )


@dataclass(frozen=True, slots=True)
class State:
    """Payload of STATE: u8 of :class:`StateFlag`, then one u16 per channel."""

    flags: int
    raw: tuple[int, ...]

    def pack(self) -> bytes:
        """Return the payload's bytes."""
        return struct.pack(f"<B{len(self.raw)}H", self.flags, *self.raw)

    @classmethod
    def unpack(cls, payload: bytes) -> State:
        """Read a payload; ProtocolError when it does not hold whole channels."""
        if len(payload) % 2 != 1:
            raise _wrong_length("STATE", "1 and 2 for each channel", payload)
        flags, *raw = struct.unpack(f"<B{len(payload) // 2}H", payload)
        return cls(flags, tuple(raw))


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Payload of SAMPLES: u8 of :class:`StateFlag` (at the last), u8 count, u32 ``first``, the samples.

    ``first`` numbers the first sample since boot, from 0; ``raw`` is u16 of shape (count, channels that
    are fitted). The frame's ``t_us`` is the time of the first sample, each other one comes a period of
    HELLO's ``sample_rate`` later.
    """

    flags: int
    first: int
    raw: NDArray[np.uint16]

    def pack(self) -> bytes:
        """Return the payload's bytes."""
        head = _SAMPLES.pack(self.flags, len(self.raw), self.first & 0xFFFFFFFF)
        return head + self.raw.astype("<u2").tobytes()

    @classmethod
    def unpack(cls, payload: bytes) -> Samples:
        """Read a payload; ProtocolError when it does not hold whole samples."""
        count = payload[1] if len(payload) > _SAMPLES.size else 0
        if count == 0 or (len(payload) - _SAMPLES.size) % (2 * count):
            raise _wrong_length("SAMPLES", f"{_SAMPLES.size} and 2 for each channel of each sample", payload)
        flags, _, first = _SAMPLES.unpack_from(payload)
        raw = np.frombuffer(payload, dtype="<u2", offset=_SAMPLES.size).reshape(count, -1)
        return cls(flags, first, raw.astype(np.uint16))


@dataclass(frozen=True, slots=True)
class SetCommand:
    """Payload of SET: one u16 per command, scaled as the channel in STATE that shows it in effect."""

    raw: tuple[int, ...]

    def pack(self) -> bytes:
        """Return the payload's bytes."""
        return struct.pack(f"<{len(self.raw)}H", *self.raw)

    @classmethod
    def unpack(cls, payload: bytes) -> SetCommand:
        """Read a payload; ProtocolError when it does not hold whole commands."""
        if len(payload) % 2:
            raise _wrong_length("SET", "2 for each command", payload)
        return cls(struct.unpack(f"<{len(payload) // 2}H", payload))


@dataclass(frozen=True, slots=True)
class Config:
    """Payload of CONFIG: u16 ``command_timeout_ms``, after which a device left alone goes safe.

    For devices with a limit on how long an output lasts a u16 ``longest_output_s`` follows: an output
    other than the safe one ends after that many seconds without a break, or earlier by the device's own.
    """

    command_timeout_ms: int
    longest_output_s: int | None = None

    def pack(self) -> bytes:
        """Return the payload's bytes."""
        head = _CONFIG.pack(self.command_timeout_ms)
        return head if self.longest_output_s is None else head + _LONGEST_OUTPUT.pack(self.longest_output_s)

    @classmethod
    def unpack(cls, payload: bytes) -> Config:
        """Read a payload; ProtocolError when its length is not that of a CONFIG."""
        if len(payload) == _CONFIG.size:
            return cls(*_CONFIG.unpack(payload))
        if len(payload) != _CONFIG.size + _LONGEST_OUTPUT.size:
            raise _wrong_length("CONFIG", f"{_CONFIG.size} or {_CONFIG.size + _LONGEST_OUTPUT.size}", payload)
        return cls(*_CONFIG.unpack_from(payload), *_LONGEST_OUTPUT.unpack_from(payload, _CONFIG.size))


def encode(frame: Frame) -> bytes:
    """Return the frame's bytes on the wire, delimiter included; seq and t_us are wrapped here."""
    body = _HEADER.pack(PROTOCOL_VERSION, frame.type, frame.seq & 0xFFFF, frame.t_us & 0xFFFFFFFF)
    body += frame.payload
    return bytes(cobs.encode(body + _CRC.pack(crc_hqx(body, 0xFFFF)))) + DELIMITER


class Decoder:
    """Takes bytes as they come and gives whole frames; never raises, whatever the bytes.

    ``frames`` counts good ones, ``crc_errors`` pieces between two delimiters that were no frame,
    ``other_versions`` intact frames of another protocol version (``last_other_version`` says which)
    and ``resyncs`` how often a good frame followed upon bytes that had to be thrown away. What
    stands before the first delimiter is thrown away uncounted: nobody joins a talk at its start.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.crc_errors = 0
        self.resyncs = 0
        self.other_versions = 0
        self.last_other_version = PROTOCOL_VERSION
        self._pending = bytearray()
        self._overlong = False
        self._joined = False
        self._astray = False

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that ``data`` completes, in order."""
        *pieces, rest = data.split(DELIMITER)
        frames = []
        for piece in pieces:
            frame = self._complete(piece)
            if frame is not None:
                frames.append(frame)
        self._append(rest)
        return frames

    def _append(self, piece: bytes) -> None:
        self._pending += piece
        if len(self._pending) > LONGEST_FRAME:
            self._overlong = True
            self._pending.clear()

    def _complete(self, piece: bytes) -> Frame | None:
        self._append(piece)
        encoded, overlong, joined = bytes(self._pending), self._overlong, self._joined
        self._pending.clear()
        self._overlong, self._joined = False, True
        if not encoded and not overlong:
            return None
        body = None if overlong else _intact(encoded)
        frame = None if body is None else self._parse(body)
        if frame is not None:
            self.frames += 1
            self.resyncs += self._astray
            self._astray = False
        elif joined:
            self.crc_errors += body is None
            self._astray = True
        return frame

    def _parse(self, body: bytes) -> Frame | None:
        version, kind, seq, t_us = _HEADER.unpack_from(body)
        if version != PROTOCOL_VERSION:
            self.other_versions += 1
            self.last_other_version = version
            return None
        return Frame(kind, seq, t_us, body[_HEADER.size :])


class Unwrapper:
    """Turns a counter that wraps after ``bits`` bits into one that does not.

    Values are taken to go forward: a step back is read as a wrap, and a silence longer than one
    wrap cannot be seen.
    """

    def __init__(self, bits: int) -> None:
        self._modulus = 1 << bits
        self._last: int | None = None

    def unwrap(self, value: int) -> int:
        """Return the counter that continues the one before."""
        if self._last is None:
            self._last = value
        else:
            self._last += (value - self._last) % self._modulus
        return self._last


def _intact(encoded: bytes) -> bytes | None:
    """Undo COBS and check the CRC of what stood between two delimiters; None when it is no frame."""
    try:
        body = bytes(cobs.decode(encoded))
    except cobs.DecodeError:
        return None
    if len(body) < _HEADER.size + _CRC.size or crc_hqx(body[:-2], 0xFFFF) != _CRC.unpack(body[-2:])[0]:
        return None
    return body[: -_CRC.size]


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\x00").decode("ascii", errors="replace")


def _shortest(value: float) -> float:
    """Undo the digits that a 32-bit float grows when it is widened: 0.1 stays 0.1."""
    wire = struct.pack("<f", value)
    shorter = (float(f"{value:.{digits}g}") for digits in range(6, 9))
    return next((number for number in shorter if struct.pack("<f", number) == wire), value)


def _wrong_length(what: str, expected: str, payload: bytes) -> ProtocolError:
    return ProtocolError(
        f"payload of {what}: expected {expected} bytes, found {len(payload)}: {payload[:16].hex(' ')}"
    )
