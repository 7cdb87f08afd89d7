"""Who is at the other end: the talk that comes before the first sample."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator

from labhil.errors import ConnectError, ProtocolError
from labhil.link import (
    DELIMITER,
    PROTOCOL_VERSION,
    Config,
    Decoder,
    Frame,
    Hello,
    MessageType,
    StateFlag,
    encode,
)
from labhil.serial_rig.port import Port

ASK_EVERY = 0.25
ANSWER_WITHIN = 4.0
"""An Arduino needs up to two seconds from the opening of its port to its first word."""
GARBAGE_FOR = 2.0
CONFIGURED_WITHIN = 2.0


class Sender:
    """Numbers and sends the host's messages."""

    def __init__(self, port: Port, first_seq: int) -> None:
        self._port = port
        self._first = first_seq
        self._sent: Counter[int] = Counter()

    def send(self, kind: MessageType, payload: bytes = b"") -> int:
        """Send a message; return its seq as the device sees it."""
        seq = (self._first + self._sent[kind]) & 0xFFFF
        self._sent[kind] += 1
        t_us = time.monotonic_ns() // 1000
        # the delimiter in front ends whatever noise the device may have taken for a beginning
        self._port.send(DELIMITER + encode(Frame(kind, seq, t_us, payload)))
        return seq


def ask_hello(port: Port, decoder: Decoder, sender: Sender) -> Hello:
    """Ask until the device says HELLO; what was sent before its answer is old and thrown away.

    Raises ConnectError when nothing at all comes, ProtocolError when it is not our protocol.
    """
    requests: set[int] = set()
    heard = bytearray()
    began = time.monotonic()
    first_byte = began + ANSWER_WITHIN
    try:
        for data in _ask_repeatedly(
            port, lambda: requests.add(sender.send(MessageType.HELLO_REQUEST)), ANSWER_WITHIN
        ):
            if data and not heard:
                first_byte = time.monotonic()
            heard += data[:64]
            for frame in decoder.feed(data):
                if frame.type == MessageType.HELLO and Hello.unpack(frame.payload).answers in requests:
                    return Hello.unpack(frame.payload)
            only_garbage = decoder.frames == 0 and time.monotonic() - first_byte > GARBAGE_FOR
            if only_garbage or decoder.other_versions:
                break
    except ConnectError as error:
        if decoder.frames or not heard:
            raise ConnectError(f"{error}; expected HELLO: is this the port of the bench?") from error
    raise _hello_error(port.address, decoder, bytes(heard))


def configure(port: Port, decoder: Decoder, sender: Sender, config: Config) -> None:
    """Send the configuration, and SAFE, until a sample says that both have arrived.

    A device that was not reset by the opening of its port may still carry out what somebody else
    commanded. ProtocolError when no sample says so.
    """
    payload = config.pack()
    required = StateFlag.CONFIGURED | StateFlag.SAFE

    def ask() -> None:
        sender.send(MessageType.SAFE)
        sender.send(MessageType.CONFIG, payload)

    for data in _ask_repeatedly(port, ask, CONFIGURED_WITHIN):
        for frame in decoder.feed(data):
            sample = frame.type in (MessageType.STATE, MessageType.SAMPLES)
            # both begin with the flags
            if sample and frame.payload and frame.payload[0] & (required | StateFlag.EXPIRED) == required:
                return
    raise ProtocolError(
        f"{port.address}: expected samples that acknowledge the configuration and the safe state within"
        f" {CONFIGURED_WITHIN:g} s of HELLO, found none"
    )


def _ask_repeatedly(port: Port, ask: Callable[[], object], within: float) -> Iterator[bytes]:
    """Call ``ask`` again and again for ``within`` s, and give what comes in meanwhile."""
    began = time.monotonic()
    count = 0
    while (elapsed := time.monotonic() - began) < within:
        if elapsed >= count * ASK_EVERY:
            ask()
            count += 1
        yield port.receive(0.05)


def _hello_error(address: str, decoder: Decoder, heard: bytes) -> ConnectError | ProtocolError:
    if not heard:
        return ConnectError(
            f"{address}: the port is open, but nothing came from it within {ANSWER_WITHIN:g} s:"
            " is the bench powered, and is this its port?"
        )
    if decoder.other_versions:
        return ProtocolError(
            f"{address}: expected protocol version {PROTOCOL_VERSION}, found {decoder.last_other_version}:"
            " firmware and driver do not belong together"
        )
    if decoder.frames:
        return ProtocolError(
            f"{address}: expected HELLO, found {decoder.frames} other frames in {ANSWER_WITHIN:g} s"
        )
    return ProtocolError(
        f"{address}: expected frames (COBS, zero byte at the end), found {len(heard)} or more bytes"
        f" without one: {heard[:16].hex(' ')} …: is this another device or another baud rate?"
    )
