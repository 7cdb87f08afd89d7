"""Receiver of RTDE, version 2: every sample of the controller, in order, with the controller's clock.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide". All numbers are big-endian; a package is its
size (u16, header included), a letter, and a payload. The getters of the client library return the newest
value of one variable at a time, so that samples would be missed and rows would mix two of them.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from labhil.errors import ConnectError, ProtocolError

PORT = 30004
PROTOCOL_VERSION = 2
ANSWER_TIMEOUT = 3.0
"""Longest time of an answer of the controller, s."""
CHUNK = 1 << 16
SILENT, BEHIND, LONGEST_BURST = 0.1, 0.005, 0.03
"""s: after so long a silence bytes that follow within ``BEHIND`` of one another belong to one queue, for
``LONGEST_BURST`` at most."""
LARGEST_READ = 1 << 22
"""Bytes that are taken at once: seconds of samples."""
HEADER = struct.Struct(">HB")

ASK_PROTOCOL, ASK_VERSION, SETUP_OUTPUTS, START, DATA = b"VvOSU"
LETTERS = b"VvOSUMIP"
"""Letters of all packages of a controller; ``M`` is a text, ``I`` and ``P`` are never requested."""

FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
NOT_FOUND = "NOT_FOUND"


class PackageParser:
    """Splits a stream of bytes into packages; ``who`` is the sender's name in messages."""

    def __init__(self, who: str) -> None:
        self._who = who
        self._incomplete = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Add bytes, and yield (letter, payload) of every complete package.

        Raises:
            ProtocolError: The bytes are no RTDE packages.
        """
        buffer = self._incomplete
        buffer += data
        start = 0
        try:
            while len(buffer) - start >= HEADER.size:
                size, letter = HEADER.unpack_from(buffer, start)
                if size < HEADER.size or letter not in LETTERS:
                    raise ProtocolError(
                        f"{self._who}: expected RTDE packages, found one of {size} bytes and kind {letter}: "
                        "is this a UR?"
                    )
                if len(buffer) - start < size:
                    break
                payload = bytes(buffer[start + HEADER.size : start + size])
                start += size
                yield letter, payload
        finally:
            del buffer[:start]


@dataclass(frozen=True, slots=True)
class Recipe:
    """Layout of a data package: its number, the struct, and the slice of each variable in the numbers."""

    number: int
    layout: struct.Struct
    slices: dict[str, slice]

    def unpack(self, payload: bytes) -> tuple[float, ...]:
        """Return the numbers of a package.

        Raises:
            ProtocolError: The package is not of this recipe.
        """
        if len(payload) != 1 + self.layout.size or payload[0] != self.number:
            raise ProtocolError(
                f"expected {1 + self.layout.size} bytes of recipe {self.number}, found {len(payload)} bytes"
                f" of recipe {payload[0] if payload else 'none'}"
            )
        return self.layout.unpack_from(payload, 1)


class Receiver:
    """A receiving connection: :meth:`greet`, :meth:`start`, then :meth:`packages`.

    Args:
        host: Address of the controller.
        timeout: Longest time of an answer, s.

    Raises:
        ConnectError: No controller answers.
    """

    def __init__(self, host: str, timeout: float = ANSWER_TIMEOUT) -> None:
        self.host = host
        self._timeout = timeout
        try:
            self._socket = socket.create_connection((host, PORT), timeout)
        except OSError as error:
            raise ConnectError(
                f"{host}: expected a UR controller's RTDE on port {PORT}, found: {error}; is the address"
                " right, the arm's controller switched on, and RTDE enabled under Security → Services?"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._packages = PackageParser(host)
        self._received_at = 0.0
        self._early: list[bytes] = []
        self.version: tuple[int, int, int, int] = (0, 0, 0, 0)

    def greet(self) -> tuple[int, int, int, int]:
        """Negotiate the protocol's version; return the controller's: major, minor, bugfix, build."""
        self.negotiate()
        major, minor, bugfix, build = self._ask(ASK_VERSION, b"", ">4I")
        self.version = (major, minor, bugfix, build)
        return self.version

    def negotiate(self) -> None:
        """Agree on the protocol's version, and nothing more.

        Raises:
            ProtocolError: It is no controller, or one that does not speak this version.
            ConnectError: There is no answer.
        """
        (accepted,) = self._ask(ASK_PROTOCOL, struct.pack(">H", PROTOCOL_VERSION), ">B")
        if accepted != 1:
            raise ProtocolError(
                f"{self.host}: the controller does not speak RTDE version {PROTOCOL_VERSION}: it needs"
                " software 3.10 / 5.4 or newer"
            )

    def start(self, needed: Sequence[str], optional: Sequence[str], rate: float) -> Recipe:
        """Request variables and start their transmission.

        Args:
            needed: Names of required variables.
            optional: Names of variables that the controller may not know.
            rate: Rate of packages, Hz.

        Raises:
            ProtocolError: The controller does not know a required variable, or refuses.
        """
        names = [*needed, *optional]
        number, types = self._set_up(names, rate)
        known = [name for name, kind in zip(names, types, strict=True) if kind != NOT_FOUND]
        missing = [name for name in needed if name not in known]
        if missing:
            raise ProtocolError(
                f"{self.host}: the controller (software {'.'.join(map(str, self.version))}) does not know"
                f" {', '.join(missing)}"
            )
        if len(known) < len(names):
            number, types = self._set_up(known, rate)
        (started,) = self._ask(START, b"", ">B")
        if started != 1:
            raise ProtocolError(f"{self.host}: the controller refused to send its data")
        return _recipe(number, known, types)

    def packages(self) -> list[bytes]:
        """Return the payloads of all data packages received.

        Raises:
            ConnectError: The connection broke.
        """
        early, self._early = self._early, []
        received = self._packages.feed(self._receive())
        return early + [payload for letter, payload in received if letter == DATA]

    def fileno(self) -> int:
        """Return the file descriptor of the socket."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._socket.close()

    def _receive(self) -> bytes:
        """All that has come in: what waited, in the network or for a busy machine, came before its last.

        After a silence the first bytes may be the oldest of a queue that follows.
        """
        received, began = bytearray(), time.monotonic()
        wait = BEHIND if began - self._received_at > SILENT else 0.0
        while len(received) < LARGEST_READ and time.monotonic() - began < LONGEST_BURST:
            if not select.select([self._socket], [], [], wait if received else 0.0)[0]:
                break
            try:
                data = self._socket.recv(CHUNK)
            except OSError as error:
                if received:
                    break  # the next call says so
                raise ConnectError(f"{self.host}: the RTDE connection broke: {error}") from error
            if not data:
                if received:
                    break
                raise ConnectError(f"{self.host}: the controller closed the RTDE connection")
            received += data
        if received:
            self._received_at = began
        return bytes(received)

    def _set_up(self, names: Sequence[str], rate: float) -> tuple[int, list[str]]:
        payload = struct.pack(">d", rate) + ",".join(names).encode()
        answer = self._answer(SETUP_OUTPUTS, payload)
        types = answer[1:].decode("ascii", "replace").rstrip(",").split(",")
        if len(types) != len(names) or not set(types) <= {*FORMATS, NOT_FOUND}:
            raise ProtocolError(
                f"{self.host}: expected types of {len(names)} variables, found {answer!r:.200}"
            )
        return answer[0], types

    def _ask(self, letter: int, payload: bytes, layout: str) -> tuple[int, ...]:
        answer = self._answer(letter, payload)
        if len(answer) != struct.calcsize(layout):
            raise ProtocolError(
                f"{self.host}: expected an answer of {struct.calcsize(layout)} bytes to {chr(letter)!r},"
                f" found {answer!r:.80}"
            )
        return struct.unpack(layout, answer)

    def _answer(self, letter: int, payload: bytes) -> bytes:
        deadline = time.monotonic() + self._timeout
        try:
            self._socket.sendall(HEADER.pack(HEADER.size + len(payload), letter) + payload)
        except OSError as error:
            raise ConnectError(f"{self.host}: the RTDE connection broke: {error}") from error
        answer: bytes | None = None
        while (remaining := deadline - time.monotonic()) > 0:
            select.select([self._socket], [], [], remaining)
            for kind, body in self._packages.feed(self._receive()):
                if kind == letter and answer is None:
                    answer = body
                elif kind == DATA:
                    self._early.append(body)
            if answer is not None:
                return answer
        raise ConnectError(
            f"{self.host}: no answer to {chr(letter)!r} within {self._timeout:g} s on port {PORT}"
        )


def _recipe(number: int, names: Sequence[str], types: Sequence[str]) -> Recipe:
    slices, start = {}, 0
    for name, kind in zip(names, types, strict=True):
        count = len(struct.unpack(">" + FORMATS[kind], bytes(struct.calcsize(">" + FORMATS[kind]))))
        slices[name] = slice(start, start + count)
        start += count
    return Recipe(number, struct.Struct(">" + "".join(FORMATS[kind] for kind in types)), slices)
