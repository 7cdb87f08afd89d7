"""HTML elements as values. Every text is escaped when it enters an element."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from dataclasses import dataclass

VOID = frozenset({"br", "hr", "meta", "img", "input", "col", "wbr"})

UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Characters that HTML does not allow, or that UTF-8 cannot carry (undecodable bytes of a path)."""


@dataclass(frozen=True, slots=True)
class Markup:
    """Hold text that is HTML already."""

    text: str


Content = Markup | str | int | None


def clean(text: str) -> str:
    """Replace each character that HTML does not allow."""
    return UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", text)


def tag(name: str, /, *content: Content, **attributes: str | int | None) -> Markup:
    """Make an element with its content and attributes.

    Args:
        name: Name of the element.
        content: Text, which is escaped, and elements; None is left out.
        attributes: ``class_`` is ``class``, ``aria_label`` is ``aria-label``; None is left out.
    """
    attribute_text = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{_escape(str(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in VOID:
        return Markup(f"<{name}{attribute_text}>")
    return Markup(f"<{name}{attribute_text}>{join(content).text}</{name}>")


def join(content: Iterable[Content]) -> Markup:
    """Concatenate texts and elements."""
    return Markup("".join(_html(piece) for piece in content))


def _html(piece: Content) -> str:
    if piece is None:
        return ""
    return piece.text if isinstance(piece, Markup) else _escape(str(piece))


def _escape(text: str) -> str:
    return html.escape(clean(text), quote=True)
