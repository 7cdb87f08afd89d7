"""RTDE's binary format: packages, recipes and the types of their fields (protocol version 2, big-endian)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

Value = float | tuple[float, ...]
"""One variable: a number (int, float or bool), or a tuple of three or six."""

HEADER = struct.Struct(">HB")
MAX_PACKAGE_SIZE = 65535

FORMATS: Mapping[str, str] = {
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
"""The types of the protocol and their formats in :mod:`struct`."""
WIDTHS: Mapping[str, int] = {name: int(layout[:-1] or 1) for name, layout in FORMATS.items()}
"""Number of values of each type."""


class Command(IntEnum):
    """Kind of a package: the third byte of its header."""

    PROTOCOL_VERSION = 86
    CONTROLLER_VERSION = 118
    TEXT = 77
    DATA = 85
    OUTPUTS = 79
    INPUTS = 73
    START = 83
    PAUSE = 80


class FramingError(ValueError):
    """Bytes are no package."""


def package(command: int, payload: bytes = b"") -> bytes:
    """Return a complete package.

    Raises:
        FramingError: The payload is longer than 65532 bytes.
    """
    size = HEADER.size + len(payload)
    if size > MAX_PACKAGE_SIZE:
        raise FramingError(
            f"a package holds at most {MAX_PACKAGE_SIZE - HEADER.size} bytes, found {len(payload)}"
        )
    return HEADER.pack(size, command) + payload


class PackageParser:
    """Splits a stream of bytes into packages."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def packages(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Add bytes, and yield each complete package as (command, payload).

        Raises:
            FramingError: A size is smaller than the header; the bytes after it are lost.
        """
        buffer = self._buffer
        buffer += data
        while len(buffer) >= HEADER.size:
            size, command = HEADER.unpack_from(buffer)
            if size < HEADER.size:
                buffer.clear()
                raise FramingError(f"a package of {size} bytes: expected at least {HEADER.size}")
            if len(buffer) < size:
                return
            payload = bytes(buffer[HEADER.size : size])
            del buffer[:size]
            yield command, payload


@dataclass(frozen=True, slots=True)
class Recipe:
    """Variables in the order of a data package; ``types`` are names of ``FORMATS``."""

    names: tuple[str, ...]
    types: tuple[str, ...]
    _struct: struct.Struct = field(init=False, repr=False, compare=False)
    _widths: tuple[int, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        layout = "".join(FORMATS[name] for name in self.types)
        # computed once; the dataclass is frozen
        object.__setattr__(self, "_struct", struct.Struct(f">{layout}"))
        object.__setattr__(self, "_widths", tuple(WIDTHS[name] for name in self.types))

    @property
    def size(self) -> int:
        """Bytes of its fields, without header and recipe id."""
        return self._struct.size

    def pack(self, values: Mapping[str, Value]) -> bytes:
        """Return the fields as bytes.

        Raises:
            struct.error: A number does not fit its type.
        """
        flat: list[float] = []
        for name in self.names:
            value = values[name]
            if isinstance(value, tuple):
                flat += value
            else:
                flat.append(value)
        return self._struct.pack(*flat)

    def unpack(self, data: bytes) -> dict[str, Value]:
        """Read fields from the beginning of ``data``.

        Raises:
            FramingError: It is too short.
        """
        if len(data) < self._struct.size:
            raise FramingError(f"{len(data)} bytes for a recipe of {self._struct.size}")
        flat = self._struct.unpack_from(data)
        values: dict[str, Value] = {}
        index = 0
        for name, width in zip(self.names, self._widths, strict=True):
            values[name] = flat[index] if width == 1 else flat[index : index + width]
            index += width
        return values


def data_package(recipe_id: int, fields: bytes) -> bytes:
    """Return a data package with packed fields."""
    return package(Command.DATA, bytes([recipe_id]) + fields)


def text_package(message: str, source: str = "labhil", level: int = 2) -> bytes:
    """Return a text message (level 0 exception, 1 error, 2 warning, 3 info)."""
    text, origin = message.encode()[:255], source.encode()[:255]
    return package(Command.TEXT, bytes([len(text)]) + text + bytes([len(origin)]) + origin + bytes([level]))


def split_names(payload: bytes) -> tuple[str, ...]:
    """Return the names in a comma-separated list, without the empty one that clients send at its end."""
    return tuple(name.strip() for name in payload.decode("ascii", "replace").split(",") if name.strip())


def type_list(recipe_id: int, types: Sequence[str]) -> bytes:
    """Return the answer to a setup request: the recipe's id and its types."""
    return bytes([recipe_id]) + ",".join(types).encode()
