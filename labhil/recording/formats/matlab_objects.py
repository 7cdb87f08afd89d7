"""MATLAB objects in MAT files: their names, the references to them, and how to convert those not read."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator

COMPRESSED, MATRIX = 15, 14
"""Types of the elements of a MAT file of version 5."""

OPAQUE = 17
"""Class of an array that is an object."""

HEADER = 128
HEAD_OF_ELEMENT = 1024
"""Bytes that contain an element's flags, name and class; names have at most 63 characters."""

REFERENCE = 0xDD000000
"""First of the integers of a reference to an object."""

ADVICE = {
    "timetable": "S = table2struct(timetable2table({0}), 'ToScalar', true); "
    "S.Time = seconds(S.Time - S.Time(1))",
    "table": "S = table2struct({0}, 'ToScalar', true)",
    "timeseries": "S = struct('t', {0}.Time, 'x', {0}.Data)",
    "Simulink.SimulationData.Dataset": "V = {0}{{1}}.Values; S = struct('t', V.Time, 'x', V.Data)",
    "Simulink.SimulationOutput": "V = {0}.logsout{{1}}.Values; S = struct('t', V.Time, 'x', V.Data)",
    "datetime": "S = struct('t', posixtime({0}))",
    "duration": "S = struct('t', seconds({0}))",
}


def object_advice(name: str, kind: str) -> str:
    """Message that an object ``name`` of the class ``kind`` is no column, with MATLAB code to convert it."""
    what = ADVICE.get(kind, "S = struct({0})").format(name)
    return f"an object of the class {kind}; in MATLAB: {what}; save('plain.mat', '-struct', 'S')"


def list_objects(data: bytes) -> list[tuple[str, str]]:
    """List name and class of the objects among the variables of a MAT file of version 5."""
    if data[126:128] not in (b"IM", b"MI"):
        return []
    order = "<" if data[126:128] == b"IM" else ">"
    return [item for head in _array_heads(data, order) if (item := _object(head, order)) is not None]


def _array_heads(data: bytes, order: str) -> Iterator[bytes]:
    """First bytes of every array in the file."""
    position = HEADER
    while position + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        body = data[position + 8 : position + 8 + size]
        if kind == COMPRESSED:
            try:
                yield zlib.decompressobj().decompress(body, HEAD_OF_ELEMENT)
            except zlib.error:
                return
        elif kind == MATRIX:
            yield data[position : position + HEAD_OF_ELEMENT]
        else:
            return
        position += 8 + size


def list_references(data: bytes) -> dict[str, list[int]]:
    """List the references of the variables of a MAT file of version 5 that are objects, by name."""
    if data[126:128] not in (b"IM", b"MI"):
        return {}
    order = "<" if data[126:128] == b"IM" else ">"
    references = {}
    for head in _array_heads(data, order):
        item = _object(head, order)
        # the class is followed by REFERENCE, the number of axes, their lengths, the objects and the class
        start = head.find(struct.pack(f"{order}I", REFERENCE))
        if item is not None and start >= 0:
            words = head[start : start + (len(head) - start) // 4 * 4]
            numbers = [number for (number,) in struct.iter_unpack(f"{order}I", words)]
            axes = numbers[1] if len(numbers) > 1 else 0
            count = math.prod(numbers[2 : 2 + axes]) if 0 < axes <= 8 else 0
            references[item[0]] = numbers[: 2 + axes + count + 1]
    return references


def _object(head: bytes, order: str) -> tuple[str, str] | None:
    """Name and class of an object, whose flags are followed by its name, "MCOS" and its class."""
    if len(head) < 24 or struct.unpack_from(f"{order}I", head, 16)[0] & 0xFF != OPAQUE:
        return None
    texts: list[bytes] = []
    position = 24
    while len(texts) < 3 and position + 8 <= len(head):
        word, size = struct.unpack_from(f"{order}II", head, position)
        if word >> 16:  # a short element: size and type in one word, then up to four bytes
            texts.append(head[position + 4 : position + 4 + (word >> 16)])
            position += 8
        else:
            texts.append(head[position + 8 : position + 8 + size])
            position += 8 + -(-size // 8) * 8
    if len(texts) < 3:
        return None
    return texts[0].decode("latin-1"), texts[2].decode("latin-1")
