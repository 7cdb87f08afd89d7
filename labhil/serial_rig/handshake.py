"""The handshake before the first sample: identify the device and configure it."""

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

REQUEST_INTERVAL = 0.25
"""Time between two requests, s."""
HELLO_TIMEOUT = 4.0
"""How long the device may take to answer, s: an Arduino boots for up to 2 s when its port is opened."""
GARBAGE_TIMEOUT = 2.0
"""How long bytes without a frame are accepted, s."""
CONFIG_TIMEOUT = 2.0
"""How long the device may take to acknowledge its configuration, s."""


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
        # the delimiter in front ends noise that the device may have taken for the beginning of a frame
        self._port.send(DELIMITER + encode(Frame(kind, seq, t_us, payload)))
        return seq


def request_hello(port: Port, decoder: Decoder, sender: Sender) -> Hello:
    """Request HELLO until the device answers; frames before the answer are discarded.

    Raises:
        ConnectError: Nothing comes from the port.
        ProtocolError: What comes is not this protocol.
    """
    requests: set[int] = set()
    received = bytearray()
    start = time.monotonic()
    first_byte = start + HELLO_TIMEOUT
    try:
        for data in _request_repeatedly(
            port, lambda: requests.add(sender.send(MessageType.HELLO_REQUEST)), HELLO_TIMEOUT
        ):
            if data and not received:
                first_byte = time.monotonic()
            received += data[:64]
            for frame in decoder.feed(data):
                if frame.type == MessageType.HELLO and Hello.unpack(frame.payload).answers in requests:
                    return Hello.unpack(frame.payload)
            only_garbage = decoder.frames == 0 and time.monotonic() - first_byte > GARBAGE_TIMEOUT
            if only_garbage or decoder.other_versions:
                break
    except ConnectError as error:
        if decoder.frames or not received:
            raise ConnectError(f"{error}; expected HELLO: is this the port of the bench?") from error
    raise _hello_error(port.address, decoder, bytes(received))


def configure(port: Port, decoder: Decoder, sender: Sender, config: Config) -> None:
    """Send SAFE and the configuration until a sample acknowledges both.

    A device that was not reset when its port was opened may still follow an earlier command.

    Raises:
        ProtocolError: No sample acknowledges them in time.
    """
    payload = config.pack()
    required = StateFlag.CONFIGURED | StateFlag.SAFE

    def ask() -> None:
        sender.send(MessageType.SAFE)
        sender.send(MessageType.CONFIG, payload)

    for data in _request_repeatedly(port, ask, CONFIG_TIMEOUT):
        for frame in decoder.feed(data):
            is_sample = frame.type in (MessageType.STATE, MessageType.SAMPLES)
            # both begin with the flags
            if is_sample and frame.payload and frame.payload[0] & (required | StateFlag.EXPIRED) == required:
                return
    raise ProtocolError(
        f"{port.address}: expected samples that acknowledge the configuration and the safe state within"
        f" {CONFIG_TIMEOUT:g} s of HELLO, found none"
    )


def _request_repeatedly(port: Port, ask: Callable[[], object], timeout: float) -> Iterator[bytes]:
    """Call ``ask`` again and again for ``timeout`` s, and give what comes in meanwhile."""
    start = time.monotonic()
    count = 0
    while (elapsed := time.monotonic() - start) < timeout:
        if elapsed >= count * REQUEST_INTERVAL:
            ask()
            count += 1
        yield port.receive(0.05)


def _hello_error(address: str, decoder: Decoder, received: bytes) -> ConnectError | ProtocolError:
    if not received:
        return ConnectError(
            f"{address}: the port is open, but nothing came from it within {HELLO_TIMEOUT:g} s:"
            " is the bench powered, and is this its port?"
        )
    if decoder.other_versions:
        return ProtocolError(
            f"{address}: expected protocol version {PROTOCOL_VERSION}, found {decoder.last_other_version}:"
            " firmware and driver do not belong together"
        )
    if decoder.frames:
        return ProtocolError(
            f"{address}: expected HELLO, found {decoder.frames} other frames in {HELLO_TIMEOUT:g} s"
        )
    return ProtocolError(
        f"{address}: expected frames (COBS, zero byte at the end), found {len(received)} or more bytes"
        f" without one: {received[:16].hex(' ')} …: is this another device or another baud rate?"
    )
