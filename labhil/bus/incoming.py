"""What may come in from the bus, one model per kind: strict, finite, bounded in size and depth.

Nobody is kept from speaking on the bus, so nothing that comes in is taken as it is. :func:`parse` and
:func:`load` are the only ways in; both raise CommandRefusedError with what was expected and what was found.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

import pydantic_core
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from labhil.errors import CommandRefusedError

LARGEST = 64 * 1024
"""Bytes of a message in JSON; ours have less than 4 kB, and a schema of 60 signals some 10 kB."""
LARGEST_SCHEMA = 1024 * 1024
DEEPEST = 16
"""Levels of a JSON value; ours have at most five."""
LARGEST_NS = 2**63 - 1

Name = Annotated[str, Field(max_length=200)]
Text = Annotated[str, Field(max_length=4000)]
TimeNs = Annotated[int, Field(ge=0, le=LARGEST_NS)]
ClockNs = Annotated[int, Field(ge=-LARGEST_NS, le=LARGEST_NS)]


class Incoming(BaseModel):
    """A message from outside; fields that it does not know are left out."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True, allow_inf_nan=False)


class AnyRequest(Incoming):
    """A question that says nothing more: ``status``, ``shutdown``."""


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

    reason: Text = "told to"


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
    """The number of the last sample that the publisher of a stream, which leaves, published."""

    device: Name
    stream: Name
    last_seq: Annotated[int, Field(ge=0, le=LARGEST_NS)]


class ReplayRequest(Incoming):
    """A request to a replay; ``value`` is a speed, or a time in s of the host."""

    action: Literal["status", "pause", "play", "speed", "seek"] = "status"
    value: float = 0.0


class ReplayMessage(Incoming):
    """How far a replay is, s of the host."""

    path: Text
    position: float
    duration: float
    speed: Annotated[float, Field(gt=0)]
    paused: bool
    ended: bool


class EventMessage(Incoming):
    """Something that happened at Unix time ``t_ns``; a plain note has a ``text``."""

    t_ns: TimeNs
    kind: Name = "note"
    message: str = ""
    text: str = ""
    reason: str = ""
    state: Name = ""
    then: Name = ""


class SchemaMessage(Incoming):
    """What a stream is: its declaration (JSON in a text) and what else is known of it."""

    stream: Annotated[str, Field(max_length=LARGEST_SCHEMA)]
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
    """A stream, as its publisher declares it."""

    name: Name
    rate: Annotated[float, Field(gt=0)]
    signals: Annotated[tuple[SignalDeclaration, ...], Field(min_length=1, max_length=1000)]


class ErrorReply(Incoming):
    """Why a question was not answered."""

    error: Name
    message: str
    key: Name = ""


Message = TypeVar("Message", bound=Incoming)


def parse(kind: type[Message], payload: bytes | str, what: str, largest: int = LARGEST) -> Message:
    """Read a message of this kind; ``what`` names it in the refusal."""
    _refuse_large(payload, what, largest)
    try:
        return kind.model_validate_json(payload)
    except ValidationError as error:
        raise CommandRefusedError(_in_words(error, what)) from None
    except (ValueError, RecursionError) as error:  # bytes that are no text
        raise CommandRefusedError(f"{what}: expected JSON in UTF-8, found {excerpt(payload)}") from error


def validate(kind: type[Message], data: object, what: str) -> Message:
    """The same for data that has been read already."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise CommandRefusedError(_in_words(error, what)) from None


def load(payload: bytes | str, what: str, largest: int = LARGEST) -> dict[str, Any]:
    """Read any JSON object: finite numbers, not deeper than ``DEEPEST``."""
    _refuse_large(payload, what, largest)
    try:
        data = pydantic_core.from_json(payload, allow_inf_nan=False)
    except (ValueError, RecursionError) as error:
        raise CommandRefusedError(f"{what}: expected JSON in UTF-8, found {excerpt(payload)}") from error
    if not isinstance(data, dict):
        raise CommandRefusedError(f"{what}: expected a JSON object, found {excerpt(payload)}")
    _refuse_odd(data, what, DEEPEST)
    return data


def dump(data: Mapping[str, Any]) -> bytes:
    """Write a message so that :func:`load` takes it: no NaN or infinity, no half of a surrogate pair."""
    try:
        text = json.dumps(dict(data), ensure_ascii=False, allow_nan=False)
    except ValueError:
        text = json.dumps(_finite(dict(data)), ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8", "replace")


def is_press(payload: bytes) -> bool:
    """Whether a message that is malformed otherwise presses the emergency stop all the same."""
    try:
        return load(payload, "estop").get("action", "press") == "press"
    except CommandRefusedError:
        return False


def excerpt(payload: object) -> str:
    """The beginning of a payload or value, made printable."""
    start = payload[:60] if isinstance(payload, (bytes, str)) else payload
    text = ascii(start)
    return text if len(text) <= 80 else f"{text[:80]}…"


def _refuse_large(payload: bytes | str, what: str, largest: int) -> None:
    if len(payload) > largest:
        raise CommandRefusedError(f"{what}: expected at most {largest} bytes, found {len(payload)}")


def _refuse_odd(value: object, what: str, levels: int) -> None:
    if levels < 0:
        raise CommandRefusedError(f"{what}: expected at most {DEEPEST} levels, found more")
    if isinstance(value, float) and not math.isfinite(value):
        raise CommandRefusedError(f"{what}: expected finite numbers, found {value}")
    if isinstance(value, dict):
        for inner in value.values():
            _refuse_odd(inner, what, levels - 1)
    elif isinstance(value, list):
        for inner in value:
            _refuse_odd(inner, what, levels - 1)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(inner) for key, inner in value.items()}
    return [_finite(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def _in_words(error: ValidationError, what: str) -> str:
    """Say what the first error is, with the field and the value found there."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"])[:100].encode("ascii", "backslashreplace").decode()
    value = excerpt(first.get("input"))
    if first["type"] == "finite_number":
        return f"{what}: {place}: expected a finite number, found {value}"
    if first["type"] == "literal_error":
        return f"{what}: {place} is {first['ctx']['expected']}, found {value}"
    if first["type"] == "missing":
        return f"{what}: expected the field {place}, found none"
    message = f"{first['msg'][0].lower()}{first['msg'][1:]}"
    return f"{what}: {f'{place}: ' if place else ''}{message}, found {value}"
