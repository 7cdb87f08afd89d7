"""Errors of validated files as text, a line each: file, field, what was expected, what was found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

from labhil.errors import suggestion


def format_validation_error(error: ValidationError, path: Path, model: type[BaseModel]) -> str:
    """Format pydantic's errors, a line each: file, field, what was expected, what was found."""
    return "\n".join(f"{path}: {_format_item(item, model)}" for item in error.errors(include_url=False))


def reason_of(error: Exception, path: Path, model: type[BaseModel]) -> str:
    """Format a validation error as `format_validation_error` does, and any other error as its own text."""
    return format_validation_error(error, path, model) if isinstance(error, ValidationError) else str(error)


# pydantic names the branch of a union that it tried; that is no place in a file
PYDANTIC_BRANCHES = {"str", "int", "float", "list[float]", "constrained-int"}


def expectation(message: str) -> str:
    """What a message of pydantic expects, in the words of this program.

    Example:
        >>> expectation("Input should be greater than 0")
        'expected a value greater than 0'
    """
    message = message.removeprefix("Value error, ")
    expected = message.removeprefix("Input should be ")
    if expected == message:
        return message
    is_range = expected.startswith(("greater", "less", "in "))
    return f"expected {'a value ' if is_range else ''}{expected}"


UNKNOWN_KEY = "unknown_key"


def unknown_key(key: str, message: str) -> PydanticCustomError:
    """The error for a validator that knows better than its model which keys belong here."""
    return PydanticCustomError(UNKNOWN_KEY, "{message}", {"key": key, "message": message})


def _format_item(item: Any, model: type[BaseModel]) -> str:
    places = [str(part) for part in item["loc"] if str(part) not in PYDANTIC_BRANCHES]
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
