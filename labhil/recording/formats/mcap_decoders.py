"""Decoders of messages in MCAP files of other programs: JSON, protobuf, CDR (ROS 2) and ROS 1.

A decoded message is a mapping of names to numbers, times, lists and further mappings, or a message object of
rosbags. A text is no number, except for a date with a time of day in ISO 8601 (s of Unix time).
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FieldDescriptor

from labhil.extras import load_optional
from labhil.recording.formats.bag_messages import MAX_ARRAY_LENGTH

Decode = Callable[[bytes], Any]

ENCODINGS = ("json", "protobuf", "cdr", "ros1")
"""Supported encodings of messages, by their names in MCAP files."""

MAX_DEPTH = 32
"""Largest depth of a message that is decoded."""

MAX_DATE_LENGTH = 40
"""Largest number of characters of a date."""

_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")

_TIME_FIELDS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Fields of a time or a duration in messages of ROS 2, of Foxglove and Gazebo, of ROS 1, and of protobuf."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

_IDL_RULE = "=" * 80 + "\n"


class DecodeError(ValueError):
    """The messages of a channel cannot be decoded."""


class Stamp(NamedTuple):
    """A time or a duration.

    Attributes:
        sec: s.
        nanosec: ns beyond these.
    """

    sec: int
    nanosec: int


class MessageFormat(NamedTuple):
    """Encoding of the messages of a channel, and name, encoding and text of their schema."""

    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


def make_decoder(form: MessageFormat, purpose: str) -> Decode:
    """Make the decoder of a channel.

    Args:
        form: encoding and schema of its messages.
        purpose: beginning of the message about a missing package.

    Returns:
        Function from the bytes of a message to plain data.

    Raises:
        DecodeError: The encoding is not supported, or the schema cannot be used.
        MissingExtraError: rosbags is needed, and not installed.
    """
    if form.encoding == "json":
        return _decode_json
    if form.encoding == "protobuf":
        return _protobuf_decoder(form)
    if form.encoding in ("cdr", "ros1"):
        return _ros_decoder(form, purpose)
    raise DecodeError(f"its encoding {form.encoding or '(none)'!r} is not read")


def _decode_json(payload: bytes) -> Mapping[str, Any]:
    value = _decode_json_value(json.loads(payload.decode("utf-8")), 0)
    return value if isinstance(value, Mapping) else {"value": value}


def _decode_json_value(value: Any, depth: int) -> Any:
    if isinstance(value, (dict, list)):
        return None if depth >= MAX_DEPTH else _decode_json_parts(value, depth)
    if isinstance(value, str):
        return _parse_date(value)
    return _to_float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _decode_json_parts(value: Any, depth: int) -> Any:
    if isinstance(value, dict):
        fields = {name: _decode_json_value(inner, depth + 1) for name, inner in value.items()}
        return _parse_stamp(fields) or fields
    if len(value) > MAX_ARRAY_LENGTH:
        return None
    return _index_by_name([_decode_json_value(inner, depth + 1) for inner in value])


def _to_float(value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


def _parse_date(text: str) -> Stamp | str:
    """Unix time of a date, UTC without a zone; the text itself if it is no date."""
    if len(text) > MAX_DATE_LENGTH or not _DATE.match(text):
        return text
    try:
        moment = datetime.fromisoformat(text)
        seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH
    except (ValueError, OverflowError):
        return text
    return Stamp(seconds.days * 86400 + seconds.seconds, 1000 * seconds.microseconds)


def _parse_stamp(fields: Mapping[str, Any]) -> Stamp | None:
    """Time in two fields of integers; None if the fields are others, or more."""
    if len(fields) != 2:
        return None
    for names in _TIME_FIELDS:
        if all(name in fields for name in names):
            parts = [fields[name] for name in names]
            if all(isinstance(part, (int, float)) and abs(part) < 1e18 for part in parts):
                return Stamp(int(parts[0]), int(parts[1]))
    return None


def _index_by_name(items: list[Any]) -> Any:
    """Convert a list of mappings with unique names to a mapping by name; other lists remain lists."""
    names = [item.get("name") if isinstance(item, Mapping) else None for item in items]
    if items and all(isinstance(name, str) and name for name in names) and len(set(names)) == len(names):
        return dict(zip(names, items, strict=True))
    return items


def _protobuf_decoder(form: MessageFormat) -> Decode:
    if form.schema_encoding != "protobuf":
        raise DecodeError(
            f"its messages are protobuf, but the file holds no descriptor of {form.schema_name or 'them'}"
        )
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(form.schema).file
        pool = descriptor_pool.DescriptorPool()
        _add_files(pool, files)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(form.schema_name))
    except Exception as error:  # protobuf's own, TypeError, KeyError: depends on the implementation
        raise DecodeError(
            f"the descriptor of {form.schema_name} cannot be used: {str(error)[:200]}"
        ) from error
    return lambda payload: _decode_protobuf(kind.FromString(payload), 0)


def _add_files(pool: Any, files: Sequence[Any]) -> None:
    """Add files to the pool, each one after those that it imports."""
    waiting = {file.name: file for file in files}
    while waiting:
        ready = [file for file in waiting.values() if not waiting.keys() & set(file.dependency)]
        if not ready:
            raise DecodeError(f"the files {', '.join(waiting)} import one another")
        for file in ready:
            pool.Add(file)
            del waiting[file.name]


def _decode_protobuf(message: Any, depth: int) -> Any:
    fields: dict[str, Any] = {}
    if depth >= MAX_DEPTH:
        return fields
    for field in message.DESCRIPTOR.fields:
        if field.type == FieldDescriptor.TYPE_BYTES or (
            field.has_presence and not message.HasField(field.name)
        ):
            continue
        value = getattr(message, field.name)
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            fields[field.name] = _decode_map(value, field, depth)
        elif field.is_repeated:
            fields[field.name] = _decode_repeated(value, field, depth)
        else:
            fields[field.name] = _decode_protobuf(value, depth + 1) if field.message_type else value
    return _parse_stamp(fields) or fields


def _decode_map(value: Any, field: Any, depth: int) -> Any:
    if len(value) > MAX_ARRAY_LENGTH:
        return None
    nested = field.message_type.fields_by_name["value"].message_type is not None
    return {str(key): _decode_protobuf(value[key], depth + 1) if nested else value[key] for key in value}


def _decode_repeated(value: Any, field: Any, depth: int) -> Any:
    if len(value) > MAX_ARRAY_LENGTH:
        return None
    return _index_by_name(
        [_decode_protobuf(item, depth + 1) for item in value] if field.message_type else list(value)
    )


def _ros_decoder(form: MessageFormat, purpose: str) -> Decode:
    typesys = load_optional("rosbags.typesys", purpose)
    try:
        types, name = _ros_types(typesys, form)
        if types is None:
            store = typesys.get_typestore(typesys.Stores.LATEST)
        else:
            store = typesys.get_typestore(typesys.Stores.EMPTY)
            store.register(types)
        store.get_msgdef(name)
    except DecodeError:
        raise
    except Exception as error:  # rosbags' own, KeyError, and those of its parser
        raise DecodeError(
            f"the definition of {form.schema_name or 'its messages'} cannot be used: {str(error)[:200]}"
        ) from error
    decode = store.deserialize_cdr if form.encoding == "cdr" else store.deserialize_ros1
    return lambda payload: decode(payload, name)


def _ros_types(typesys: Any, form: MessageFormat) -> tuple[Any, str]:
    """Types that a schema defines (None if it is empty), and the name of the message type."""
    name = form.schema_name
    if "/msg/" not in name and name.count("/") == 1:
        name = name.replace("/", "/msg/")
    text = form.schema.decode("utf-8")
    if not text.strip():
        return None, name
    if form.schema_encoding in ("ros2msg", "ros1msg"):
        return typesys.get_types_from_msg(text, name), name
    if form.schema_encoding not in ("ros2idl", "omgidl"):
        raise DecodeError(
            f"its messages are {form.encoding}, and their schema is in {form.schema_encoding!r}, which is "
            "not read"
        )
    name = name.replace("::", "/")
    types: dict[str, Any] = {}
    if text.startswith(f"{_IDL_RULE}IDL: "):
        for part in text.split(_IDL_RULE)[1:]:
            types |= typesys.get_types_from_idl(part.partition("\n")[2])
    else:
        types |= typesys.get_types_from_idl(text)
    return types, name
