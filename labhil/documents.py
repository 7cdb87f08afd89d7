"""JSON and TOML from outside, read so that every text that cannot be used is one kind of error.

The parsers of the standard library recurse: a few kilobytes of brackets end them with a RecursionError, and
a number of thousands of digits with a plain ValueError. Here all of that is a DocumentError.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeGuard

DEEPEST = 64
"""Levels of tables and lists within one another. Our own files have at most 8, and Python's parsers and
whatever walks their result by recursion hold out to some hundreds."""


LARGEST = 1 << 24
"""Bytes of a document (16 MiB): our largest has a hundredth, and so many of empty lists take 400 MB."""

_DOTTED = re.compile(
    r"""(?:^|[{,])[ \t]*\[{0,2}[ \t]*"""
    rf"""(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{DEEPEST}}}""",
    re.MULTILINE,
)
"""A key with as many dots as levels are too many: the parser of TOML takes their square in memory."""


class DocumentError(ValueError):
    """A text that is no JSON or TOML, or nested too deeply."""


def read_document(path: Path) -> str:
    """Return the text of a file, which may be a device without an end.

    Raises:
        OSError: It cannot be read.
        DocumentError: It is no UTF-8, or larger than ``LARGEST``.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise DocumentError(f"expected at most {LARGEST} bytes, found more")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise DocumentError(_no_text(error)) from error


def parse_json(text: str | bytes, *, constant: Callable[[str], Any] | None = None) -> Any:
    """Return what a JSON text holds.

    Args:
        text: The text, or its bytes in UTF-8.
        constant: What to make of ``NaN``, ``Infinity`` and ``-Infinity``; the numbers when absent.

    Raises:
        DocumentError: The text is no JSON, no UTF-8, or nested deeper than ``DEEPEST``.
    """
    try:
        data = json.loads(text, parse_constant=constant)
    except json.JSONDecodeError as error:
        raise DocumentError(_no_json(error)) from error
    except UnicodeDecodeError as error:
        raise DocumentError(_no_text(error)) from error
    except ValueError as error:
        raise DocumentError(str(error)) from error
    except RecursionError:
        raise DocumentError(_too_deep()) from None
    return _not_too_deep(data)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text; DocumentError when it is none, or nested deeper than ``DEEPEST``."""
    if _DOTTED.search(text):
        raise DocumentError(_too_deep())
    try:
        data = tomllib.loads(text)
    except ValueError as error:
        raise DocumentError(str(error)) from error
    except RecursionError:
        raise DocumentError(_too_deep()) from None
    _not_too_deep(data)
    return data


def is_finite_number(value: object) -> TypeGuard[float]:
    """Whether a value is a number that a float can hold; whole numbers in a text may be too long."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) <= sys.float_info.max


def _no_text(error: UnicodeDecodeError) -> str:
    return f"it is no text (UTF-8): byte {error.start} is 0x{error.object[error.start]:02x}"


def _no_json(error: json.JSONDecodeError) -> str:
    """Where a text stops being JSON, and what stands there."""
    if not error.doc.strip():
        return "it is no JSON: it is empty"
    rest = error.doc[error.pos :].strip()
    where = f"line {error.lineno}, column {error.colno}"
    return f"it is no JSON: it ends at {where}" if not rest else f"it is no JSON: {where} is {rest[:20]!r}"


def _too_deep() -> str:
    return f"expected at most {DEEPEST} levels of lists and tables within one another, found more"


def _not_too_deep(data: Any) -> Any:
    level = [data]
    for _ in range(DEEPEST + 1):
        nested = [item for item in level if isinstance(item, (dict, list))]
        if not nested:
            return data
        level = [inner for item in nested for inner in (item.values() if isinstance(item, dict) else item)]
    raise DocumentError(_too_deep())
