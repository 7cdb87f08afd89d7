"""Models of the messages from the bus: strict, finite, bounded in size and depth.

Any local process can send on the bus, so every message is validated. :func:`parse` and :func:`load` are the
only ways in; both raise CommandRefusedError with what was expected and what was found.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

import pydantic_core
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from labhil.errors import CommandRefusedError
from labhil.validation_errors import expectation

MAX_BYTES = 64 * 1024
"""Bytes of a JSON message; labhil's own have less than 4 kB, a schema of 60 signals about 10 kB."""
MAX_SCHEMA_BYTES = 1024 * 1024
"""Bytes of a schema."""
MAX_DEPTH = 16
"""Levels of a JSON value; labhil's own have at most five."""
MAX_NS = 2**63 - 1

Name = Annotated[str, Field(max_length=200)]
Text = Annotated[str, Field(max_length=4000)]
TimeNs = Annotated[int, Field(ge=0, le=MAX_NS)]
ClockNs = Annotated[int, Field(ge=-MAX_NS, le=MAX_NS)]


class Incoming(BaseModel):
    """A message from the bus; unknown fields are ignored."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True, allow_inf_nan=False)


class AnyRequest(Incoming):
    """A request without fields: ``status``, ``shutdown``."""


class SetpointMessage(Incoming):
    """Values for some of a device's commands; ``t_ns`` is Unix time."""

    token: Name
    t_ns: TimeNs
    values: Annotated[dict[Name, float], Field(max_length=1000)]
    t_hw_ns: ClockNs | None = None


class LeaseRequest(Incoming):
    """Take, renew or return the lease on a device."""

    action: Literal["take", "renew", "return"] = "take"
    holder: Text = "somebody"
    token: Name = ""


class SafeRequest(Incoming):
    """Bring a device to its safe state."""

    reason: Text = "requested over the bus"


class EstopRequest(Incoming):
    """Press the emergency stop, or release it."""

    action: Literal["press", "release"] = "press"
    by: Text = "somebody"
    reason: Text = "no reason was given"


class RunRequest(Incoming):
    """A request to a run."""

    reason: Text | None = None


class MarkRequest(Incoming):
    """A marker for the recording of a run."""

    text: Text


class PublishedRequest(Incoming):
    """The statement of a publisher that leaves: the number of the last sample of its stream."""

    device: Name
    stream: Name
    last_seq: Annotated[int, Field(ge=0, le=MAX_NS)]


class ReplayRequest(Incoming):
    """A request to a replay; ``value`` is a speed, or a time in s from the recording's start."""

    action: Literal["status", "pause", "play", "speed", "seek"] = "status"
    value: float = 0.0


class ReplayMessage(Incoming):
    """The state of a replay; times in s from the recording's start."""

    path: Text
    position: float
    duration: float
    speed: Annotated[float, Field(gt=0)]
    paused: bool
    ended: bool


class EventMessage(Incoming):
    """An event at Unix time ``t_ns``; a plain note has a ``text``."""

    t_ns: TimeNs
    kind: Name = "note"
    message: str = ""
    text: str = ""
    reason: str = ""
    state: Name = ""
    then: Name = ""


class SchemaMessage(Incoming):
    """The schema of a stream: its declaration (JSON in a text) and its metadata."""

    stream: Annotated[str, Field(max_length=MAX_SCHEMA_BYTES)]
    metadata: Annotated[dict[Name, Text], Field(max_length=1000)] = {}


class SignalDeclaration(Incoming):
    """One signal of a stream."""

    name: Name
    unit: Name
    direction: Name
    width: Annotated[int, Field(ge=1, le=4096)] = 1
    hold: Name = "linear"
    description: Text = ""


class StreamDeclaration(Incoming):
    """The declaration of a stream."""

    name: Name
    rate: Annotated[float, Field(gt=0)]
    signals: Annotated[tuple[SignalDeclaration, ...], Field(min_length=1, max_length=1000)]


class ErrorReply(Incoming):
    """The error of a request that was not answered."""

    error: Name
    message: str
    key: Name = ""


Message = TypeVar("Message", bound=Incoming)


def parse(kind: type[Message], payload: bytes | str, what: str, largest: int = MAX_BYTES) -> Message:
    """Read a message.

    Args:
        kind: Its model.
        payload: The message, JSON.
        what: What it is, for the error message.
        largest: Bytes at most.

    Raises:
        CommandRefusedError: It is too large or malformed.
    """
    _refuse_large(payload, what, largest)
    try:
        return kind.model_validate_json(payload)
    except ValidationError as error:
        raise CommandRefusedError(_format_error(error, what)) from None
    except (ValueError, RecursionError) as error:  # bytes that are no text
        raise CommandRefusedError(f"{what}: expected JSON in UTF-8, found {excerpt(payload)}") from error


def validate(kind: type[Message], data: object, what: str) -> Message:
    """Validate data that was read already; see :func:`parse`."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise CommandRefusedError(_format_error(error, what)) from None


def load(payload: bytes | str, what: str, largest: int = MAX_BYTES) -> dict[str, Any]:
    """Read any JSON object with finite numbers and at most ``MAX_DEPTH`` levels; see :func:`parse`."""
    _refuse_large(payload, what, largest)
    try:
        data = pydantic_core.from_json(payload, allow_inf_nan=False)
    except (ValueError, RecursionError) as error:
        raise CommandRefusedError(f"{what}: expected JSON in UTF-8, found {excerpt(payload)}") from error
    if not isinstance(data, dict):
        raise CommandRefusedError(f"{what}: expected a JSON object, found {excerpt(payload)}")
    _check_values(data, what, MAX_DEPTH)
    return data


def dump(data: Mapping[str, Any]) -> bytes:
    """Write a message that :func:`load` accepts: without NaN, infinity and lone surrogates."""
    try:
        text = json.dumps(dict(data), ensure_ascii=False, allow_nan=False)
    except ValueError:
        text = json.dumps(_finite(dict(data)), ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8", "replace")


def is_stop(payload: bytes) -> bool:
    """Return whether an otherwise malformed message presses the emergency stop."""
    try:
        return load(payload, "estop").get("action", "press") == "press"
    except CommandRefusedError:
        return False


def excerpt(payload: object) -> str:
    """Return the beginning of a payload or value in printable characters."""
    start = payload[:60] if isinstance(payload, (bytes, str)) else payload
    text = ascii(start)
    return text if len(text) <= 80 else f"{text[:80]}…"


def _refuse_large(payload: bytes | str, what: str, largest: int) -> None:
    if len(payload) > largest:
        raise CommandRefusedError(f"{what}: expected at most {largest} bytes, found {len(payload)}")


def _check_values(value: object, what: str, levels: int) -> None:
    if levels < 0:
        raise CommandRefusedError(f"{what}: expected at most {MAX_DEPTH} levels, found more")
    if isinstance(value, float) and not math.isfinite(value):
        raise CommandRefusedError(f"{what}: expected finite numbers, found {value}")
    if isinstance(value, dict):
        for inner in value.values():
            _check_values(inner, what, levels - 1)
    elif isinstance(value, list):
        for inner in value:
            _check_values(inner, what, levels - 1)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(inner) for key, inner in value.items()}
    return [_finite(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def _format_error(error: ValidationError, what: str) -> str:
    """Format the first error: the field, what was expected, and the value."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"])[:100].encode("ascii", "backslashreplace").decode()
    value = excerpt(first.get("input"))
    if first["type"] == "missing":
        return f"{what}: expected the field {place}, found none"
    message = expectation(str(first["msg"]))
    message = f"{message[0].lower()}{message[1:]}"
    return f"{what}: {f'{place}: ' if place else ''}{message}, found {value}"
