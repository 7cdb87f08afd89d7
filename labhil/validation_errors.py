"""Errors of validated files as text, a line each: file, field, what was expected, what was found."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

from labhil.errors import suggestion


def format_validation_error(error: ValidationError, path: Path, model: type[BaseModel]) -> str:
    """Format pydantic's errors, a line each: file, field, what was expected, what was found."""
    lines = [_format_item(item, model) for item in _joined_branches(error.errors(include_url=False))]
    return "\n".join(f"{path}: {line}" for line in lines)


def reason_of(error: Exception, path: Path, model: type[BaseModel]) -> str:
    """Format a validation error as `format_validation_error` does, and any other error as its own text."""
    return format_validation_error(error, path, model) if isinstance(error, ValidationError) else str(error)


PYDANTIC_BRANCH = re.compile(
    r"(str|int|float|bool|constrained-\w+|(list|tuple|dict|literal|function\S*)\[.*\])"
)
"""The branch of a union that pydantic tried, which it names like a place in a file."""

PLAIN_WORDS = {
    "boolean": "true or false",
    "dictionary": "a table",
    "integer": "a whole number",
    "list": "a list",
    "number": "a number",
    "string": "a text",
    "tuple": "a list",
}
"""What a person calls the types that pydantic names."""


def expectation(message: str) -> str:
    """What a message of pydantic expects, in the words of this program.

    Example:
        >>> expectation("Input should be greater than 0")
        'expected a value greater than 0'
        >>> expectation("Input should be a valid number, unable to parse string as a number")
        'expected a number'
    """
    message = message.removeprefix("Value error, ")
    expected = message.removeprefix("Input should be ")
    if expected == message:
        return message
    kind = re.match(r"a valid (\w+)", expected)
    if kind is not None and kind[1] in PLAIN_WORDS:
        return f"expected {PLAIN_WORDS[kind[1]]}"
    is_range = expected.startswith(("greater", "less", "in "))
    return f"expected {'a value ' if is_range else ''}{expected}"


UNKNOWN_KEY = "unknown_key"


def unknown_key(key: str, message: str) -> PydanticCustomError:
    """The error for a validator that knows better than its model which keys belong here."""
    return PydanticCustomError(UNKNOWN_KEY, "{message}", {"key": key, "message": message})


def _places(item: Mapping[str, Any]) -> tuple[str, ...]:
    """The keys that lead to a place in a file."""
    return tuple(str(part) for part in item["loc"] if not PYDANTIC_BRANCH.fullmatch(str(part)))


def _joined_branches(items: Sequence[Any]) -> Iterator[dict[str, Any]]:
    """One item for each value of which pydantic says that no branch of a union takes it."""
    for _, group in groupby(items, key=lambda item: (_places(item), repr(item["input"]))):
        first, *others = group
        messages = dict.fromkeys(expectation(str(item["msg"])) for item in (first, *others))
        is_type = all(message.startswith("expected ") for message in messages)
        if not others or not is_type:
            yield from (first, *others)
            continue
        choices = " or ".join(message.removeprefix("expected ") for message in messages)
        yield {**first, "msg": f"Input should be {choices}"}


def _format_item(item: Any, model: type[BaseModel]) -> str:
    places = _places(item)
    field = ".".join(places) or "file"
    if item["type"] == "extra_forbidden":
        known = fields_at(model, item["loc"][:-1])
        return f"{field}: unknown key{suggestion(str(item['loc'][-1]), known)}; known: {', '.join(known)}"
    if item["type"] == "missing":
        return f"{field}: this key is missing"
    message = expectation(str(item["msg"]))
    if item["type"] == UNKNOWN_KEY:
        return f"{'.'.join([*places, str(item['ctx']['key'])])}: {message}"
    if item["type"] == "value_error":
        return f"{field}: {message}" if places else message
    return f"{field}: {message}, found {item['input']!r:.200}"


def fields_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Names of the keys that are allowed at a place in a file, as far as the models tell."""
    current: type[BaseModel] = model
    for part in loc:
        field = current.model_fields.get(str(part))
        inner = _model_within(field.annotation) if field is not None else None
        if inner is not None:
            current = inner
    return [name for name, field in current.model_fields.items() if not field.exclude]


def _model_within(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        model = _model_within(inner)
        if model is not None:
            return model
    return None
