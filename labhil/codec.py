"""One sample, one constant-length protobuf message: the same bytes on the bus and in the file.

A stream's declaration gives a list of fields; from that one list come the numpy dtype that packs and
unpacks, and the protobuf descriptor that lets others read the bytes. Every field is written always and
in order of its tag, so that all messages of a stream have one length and ``seq``, ``t_acq_ns`` and
``t_hw_ns`` stand at the bytes 1, 10 and 19 of each of them, whatever the stream.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labhil.bounds import content_bound
from labhil.documents import parse_json
from labhil.errors import ProtocolError
from labhil.signals import Batch, FloatArray, IntArray, Signal, Stream

LAYOUT_VERSION = "1"
"""Stands in every channel's metadata; a change of the layout changes it."""

LARGEST_WIDTH = 1 << 16
"""Scalar columns that a stream from outside may declare: a tactile skin or a spectrum has thousands."""

STAMPS = ("seq", "t_acq_ns", "t_hw_ns")
STAMP_NOTES = (
    " counts what the device sent\n",
    " ns; Unix time of the host at acquisition, one for all samples of a burst\n",
    " ns; the device's own clock\n",
)
STAMP_OFFSETS = (1, 10, 19)
"""Where the three stamps stand in a message of any stream (bytes)."""

ByteRows = NDArray[np.uint8]

_FIXED64 = 1  # protobuf wire types
_LENGTH_DELIMITED = 2


@dataclass(frozen=True, slots=True)
class _Field:
    """One protobuf field: its number, its name, how many 8-byte words it holds, and its leading bytes."""

    number: int
    name: str
    width: int
    word: str  # numpy's name of the word

    @property
    def prefix(self) -> bytes:
        """The tag, and for a vector the length that follows it."""
        if self.width == 1:
            return _varint(self.number << 3 | _FIXED64)
        return _varint(self.number << 3 | _LENGTH_DELIMITED) + _varint(8 * self.width)


class Codec:
    """Packs and unpacks the samples of one stream."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.schema_name = f"labhil.{''.join(part.capitalize() for part in stream.name.split('_'))}"
        self._fields = tuple(_fields(stream))
        self._dtype, self._template = _layout(self._fields)
        self._prefix_at = np.flatnonzero(_prefix_mask(self._fields))
        self._prefixes = self._template[self._prefix_at]

    @property
    def size(self) -> int:
        """Bytes per message; the same for every message of the stream."""
        return len(self._template)

    def encode(self, batch: Batch) -> list[bytes]:
        """Return one message per sample."""
        rows = np.empty((len(batch), self.size), dtype=np.uint8)
        rows[:] = self._template
        words = rows.view(self._dtype)[:, 0]
        for name, column in zip(STAMPS, (batch.seq, batch.t_acq_ns, batch.t_hw_ns), strict=True):
            words[name] = column
        for signal in self.stream.signals:
            columns = batch.values[:, self.stream.columns_of(signal.name)]
            words[signal.name] = columns[:, 0] if signal.width == 1 else columns
        raw, size = rows.tobytes(), self.size
        return [raw[start : start + size] for start in range(0, len(raw), size)]

    def decode(self, payloads: Sequence[bytes]) -> Batch:
        """Read messages back; ProtocolError when one of them is no message of this stream.

        Messages in our layout are read all at once; those that another program wrote with its own
        protobuf library (fields left out or in another order) one by one, NaN standing for what is
        left out.
        """
        if all(len(payload) == self.size for payload in payloads):
            rows = np.frombuffer(b"".join(payloads), dtype=np.uint8).reshape(-1, self.size)
            return self.decode_rows(rows)
        return self._decode_foreign(payloads)

    def is_own(self, payload: bytes) -> bool:
        """Whether this is a message in our layout; what others wrote with a library of theirs is not."""
        if len(payload) != self.size:
            return False
        row = np.frombuffer(payload, dtype=np.uint8)
        return bool(np.array_equal(row[self._prefix_at], self._prefixes))

    def decode_rows(self, rows: ByteRows) -> Batch:
        """Read messages that stand as rows of bytes, shape (n, size); ProtocolError as in ``decode``."""
        if not np.array_equal(
            rows[:, self._prefix_at], np.broadcast_to(self._prefixes, (len(rows), len(self._prefixes)))
        ):
            return self._decode_foreign([row.tobytes() for row in rows])
        words = np.ascontiguousarray(rows).view(self._dtype)[:, 0]
        values = np.empty((len(rows), self.stream.width))
        for signal in self.stream.signals:
            columns = self.stream.columns_of(signal.name)
            values[:, columns] = words[signal.name].reshape(len(rows), signal.width)
        seq, t_acq_ns, t_hw_ns = (np.array(words[name]) for name in STAMPS)
        return Batch(seq, t_acq_ns, t_hw_ns, values)

    def descriptor_set(self) -> bytes:
        """The serialised FileDescriptorSet that says to others what the messages mean."""
        from google.protobuf.descriptor_pb2 import FileDescriptorSet

        return bytes(FileDescriptorSet(file=[self._file_descriptor()]).SerializeToString(deterministic=True))

    @cached_property
    def message_class(self) -> Any:
        """The class of protobuf's own runtime for these messages (slow; for messages of others)."""
        from google.protobuf import descriptor_pool, message_factory

        pool = descriptor_pool.DescriptorPool()
        pool.Add(self._file_descriptor())
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(self.schema_name))

    def _file_descriptor(self) -> Any:
        from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto

        name = self.schema_name.removeprefix("labhil.")
        file = FileDescriptorProto(name=f"labhil/{self.stream.name}.proto", package="labhil", syntax="proto3")
        message = file.message_type.add(name=name)
        for field in self._fields:
            proto = message.field.add(name=field.name, number=field.number)
            stamp = field.name in STAMPS
            proto.type = FieldDescriptorProto.TYPE_FIXED64 if stamp else FieldDescriptorProto.TYPE_DOUBLE
            if field.width > 1:
                proto.label = FieldDescriptorProto.LABEL_REPEATED
                continue
            # proto3 says "optional" by a oneof with one member
            proto.label = FieldDescriptorProto.LABEL_OPTIONAL
            proto.proto3_optional = True
            proto.oneof_index = len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{field.name}")
        self._comment(file)
        return file

    def _comment(self, file: Any) -> None:
        """Put unit and meaning of each field beside it, where programs that show the schema look."""
        notes = [*STAMP_NOTES, *(_note(signal) for signal in self.stream.signals)]
        for index, note in enumerate(notes):
            # a path in a descriptor: of the messages (4) the first (0), of its fields (2) this one
            file.source_code_info.location.add(path=(4, 0, 2, index), span=(0, 0, 0), leading_comments=note)

    def _decode_foreign(self, payloads: Sequence[bytes]) -> Batch:
        from google.protobuf.message import DecodeError

        self._refuse_claim(payloads)
        stamps = np.empty((len(payloads), len(STAMPS)), dtype=np.uint64)
        values = np.full((len(payloads), self.stream.width), np.nan)
        for row, payload in enumerate(payloads):
            try:
                message = self.message_class.FromString(payload)
            except DecodeError as error:
                raise ProtocolError(self._complaint(payload, str(error))) from error
            absent = [name for name in STAMPS if not message.HasField(name)]
            if absent:
                raise ProtocolError(self._complaint(payload, f"no {', '.join(absent)} in it"))
            stamps[row] = [getattr(message, name) for name in STAMPS]
            for signal in self.stream.signals:
                self._take(message, signal, values[row])
        seq, t_acq_ns, t_hw_ns = (np.array(column) for column in stamps.view(np.int64).T)
        return Batch(seq, t_acq_ns, t_hw_ns, values)

    def _refuse_claim(self, payloads: Sequence[bytes]) -> None:
        """Fields may be left out, but not so many that a few bytes would make a table of gigabytes."""
        claimed, size = 8 * len(payloads) * self.stream.width, sum(len(payload) for payload in payloads)
        if claimed > content_bound(size):
            raise ProtocolError(
                f"stream {self.stream.name!r}: expected messages of {self.size} bytes, found {len(payloads)} "
                f"with {size} bytes in all"
            )

    def _take(self, message: Any, signal: Signal, row: FloatArray) -> None:
        columns = self.stream.columns_of(signal.name)
        if signal.width == 1:
            if message.HasField(signal.name):
                row[columns] = getattr(message, signal.name)
            return
        values = getattr(message, signal.name)
        if values and len(values) != signal.width:
            raise ProtocolError(
                f"stream {self.stream.name!r}: {signal.name} has {len(values)} values, "
                f"expected {signal.width}"
            )
        if values:
            row[columns] = values

    def _complaint(self, payload: bytes, reason: str) -> str:
        return (
            f"stream {self.stream.name!r}: expected a message of {self.size} bytes ({self.schema_name}), "
            f"found {len(payload)} bytes: {reason}"
        )


def stamps_of(payloads: Sequence[bytes]) -> IntArray:
    """Return the stamps of messages of any stream: int64 of shape (n, 3), as in ``STAMPS``.

    ProtocolError when a message is too short to hold them or does not begin with their tags.
    """
    head_size = STAMP_OFFSETS[-1] + 8
    heads = np.frombuffer(b"".join(payload[:head_size] for payload in payloads), dtype=np.uint8)
    if len(heads) != head_size * len(payloads):
        shortest = min(len(payload) for payload in payloads)
        raise ProtocolError(f"expected messages that begin with {STAMPS}, found one of {shortest} bytes")
    rows = heads.reshape(-1, head_size)
    tags = np.array([number << 3 | _FIXED64 for number in (1, 2, 3)], dtype=np.uint8)
    if not (rows[:, [offset - 1 for offset in STAMP_OFFSETS]] == tags).all():
        raise ProtocolError(f"expected messages that begin with {STAMPS}, found other tags")
    words = [np.ascontiguousarray(rows[:, offset : offset + 8]).view("<i8")[:, 0] for offset in STAMP_OFFSETS]
    return np.column_stack(words).astype(np.int64)


def stream_to_json(stream: Stream) -> str:
    """Return a stream's declaration as JSON text, as it stands in channel metadata."""
    signals = [signal.to_json() for signal in stream.signals]
    return json.dumps({"name": stream.name, "rate": stream.rate, "signals": signals})


def stream_from_json(text: str) -> Stream:
    """Read what :func:`stream_to_json` wrote; ProtocolError when it is something else."""
    try:
        data: Mapping[str, Any] = parse_json(text)
        signals = tuple(Signal.from_json(signal) for signal in data["signals"])
        stream = Stream(str(data["name"]), signals, float(data["rate"]))
        _check_sizes(stream)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise ProtocolError(f"not the declaration of a stream: {error!r} in {text[:80]!r}") from error
    return stream


def _check_sizes(stream: Stream) -> None:
    """ValueError for a declaration that no device makes."""
    if not 0 < stream.rate < float("inf"):
        raise ValueError(f"expected a positive rate, found {stream.rate}")
    if stream.width > LARGEST_WIDTH:
        raise ValueError(f"expected at most {LARGEST_WIDTH} columns, found {stream.width}")


def _note(signal: Signal) -> str:
    words = (signal.unit, signal.description, signal.direction.value)
    return f" {'; '.join(word for word in words if word)}\n"


def _fields(stream: Stream) -> Iterator[_Field]:
    names = [*STAMPS, *stream.names()]
    if len(set(names)) != len(names) or not all(name.isidentifier() and name.isascii() for name in names):
        raise ValueError(f"stream {stream.name!r}: names must be identifiers and differ, found {names}")
    for number, name in enumerate(STAMPS, start=1):
        yield _Field(number, name, 1, "<i8")
    for number, signal in enumerate(stream.signals, start=len(STAMPS) + 1):
        if signal.width < 1:
            raise ValueError(f"stream {stream.name!r}: {signal.name} must have a width of 1 or more")
        yield _Field(number, signal.name, signal.width, "<f8")


def _layout(fields: Sequence[_Field]) -> tuple[np.dtype[Any], ByteRows]:
    """Return the dtype of a message and a message whose values are all zero."""
    offsets, template = [], b""
    for field in fields:
        template += field.prefix
        offsets.append(len(template))
        template += bytes(8 * field.width)
    formats = [field.word if field.width == 1 else (field.word, (field.width,)) for field in fields]
    names = [field.name for field in fields]
    dtype: np.dtype[Any] = np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": len(template)}
    )
    return dtype, np.frombuffer(template, dtype=np.uint8)


def _prefix_mask(fields: Sequence[_Field]) -> NDArray[np.bool_]:
    parts = [np.repeat([True, False], [len(field.prefix), 8 * field.width]) for field in fields]
    return np.concatenate(parts)


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    parts.append(value)
    return bytes(parts)
