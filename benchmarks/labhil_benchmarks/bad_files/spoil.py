"""Bytes, texts and trees with something done to them at random."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

CONTROLS = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202e\u2028\x00\x7f"
"""Clears a screen, retitles a window, turns text around."""

TEXTS = (
    "",
    " ",
    "\n",
    CONTROLS,
    "[red]a[/nope]",
    "<script>alert(1)</script>",
    "../../../../outside",
    "/dev/zero",
    "/dev/full",
    "/proc/self/mem",
    ".",
    "a" * 5000,
    "a/b\\c:d*e?f",
    "\ud800".encode("utf-16", "surrogatepass").decode("utf-16", "replace"),
    "=cmd|' /C calc'!A0",
    "{0.__class__}",
    "%s%n%x",
    "nan",
    "1e999",
    "ε漢\U0001f4a9",
)
NUMBERS = (
    "0", "-1", "1", "1e308", "-1e308", "1e-320", "NaN", "inf", "-inf", "9223372036854775808",
    "-9223372036854775809", "18446744073709551616", "1e999", "0x7f", "1_000", "١٢", "9" * 400,
)  # fmt: skip
WORDS = (
    b"\x00" * 8,
    b"\xff" * 8,
    struct.pack("<q", -(2**63)),
    struct.pack("<q", 2**62),
    struct.pack("<d", 1e308),
    struct.pack("<d", math.nan),
    struct.pack("<d", math.inf),
    struct.pack("<i", -1),
    struct.pack("<I", 2**31),
    b"\x7f",
    b"\x80",
    b"\xff\xff",
)
VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1e308, -1e308, 1e-320, math.nan, math.inf, 2**63, 10**30, [], {}, [[]], [None],
    ["a", 1, {}], {"a": {"b": 1}},
)  # fmt: skip

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def spoil_bytes(data: bytes, draw: Random) -> bytes:
    """Return bytes with one to three things done to them: bits, words, blocks, or the end."""
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        data = draw.choice(BYTE_WAYS)(data, draw) if data else b"\x00"
    return data


def _flip(data: bytes, draw: Random) -> bytes:
    place = draw.randrange(len(data))
    return data[:place] + bytes([data[place] ^ 1 << draw.randrange(8)]) + data[place + 1 :]


def _word(data: bytes, draw: Random) -> bytes:
    place, word = draw.randrange(len(data)), draw.choice(WORDS)
    return data[:place] + word + data[place + len(word) :]


def _cut(data: bytes, draw: Random) -> bytes:
    return data[: draw.randrange(len(data))]


def _block(data: bytes, draw: Random) -> tuple[int, int]:
    start = draw.randrange(len(data))
    return start, min(len(data), start + draw.choice((1, 8, 100, 1000)) + draw.randrange(20))


def _double(data: bytes, draw: Random) -> bytes:
    start, end = _block(data, draw)
    return data[:end] + data[start:end] * draw.choice((1, 1, 30)) + data[end:]


def _leave_out(data: bytes, draw: Random) -> bytes:
    start, end = _block(data, draw)
    return data[:start] + data[end:]


def _swap(data: bytes, draw: Random) -> bytes:
    (a, b), (c, d) = sorted((_block(data, draw), _block(data, draw)))
    return data if c < b else data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _noise(data: bytes, draw: Random) -> bytes:
    start, end = _block(data, draw)
    return data[:start] + draw.randbytes(end - start) + data[end:]


BYTE_WAYS: tuple[Callable[[bytes, Random], bytes], ...] = (
    _flip, _flip, _flip, _word, _word, _cut, _double, _leave_out, _swap, _noise,
)  # fmt: skip


def spoil_text(text: str, draw: Random) -> str:
    """Return a text with one to three things done to it: numbers, lines, words, brackets, or a character."""
    for _ in range(draw.choice((1, 1, 2, 3))):
        text = draw.choice(TEXT_WAYS)(text, draw)
    return text


def _number(text: str, draw: Random) -> str:
    matches = list(_NUMBER.finditer(text))
    if not matches:
        return text
    chosen = draw.choice(matches)
    return text[: chosen.start()] + draw.choice(NUMBERS) + text[chosen.end() :]


def _insert(text: str, draw: Random) -> str:
    place = draw.randrange(len(text) + 1)
    return text[:place] + draw.choice(TEXTS) + text[place:]


def _nest(text: str, draw: Random) -> str:
    place, pair = draw.randrange(len(text) + 1), draw.choice(("[]", "{}", "()", '""'))
    depth = draw.choice((1, 3, 100, 20_000))
    return text[:place] + pair[0] * depth + text[place : place + 5] + pair[1] * depth + text[place + 5 :]


def _lines(text: str, draw: Random) -> str:
    lines = text.split("\n")
    k, m = draw.randrange(len(lines)), draw.randrange(len(lines))
    what = draw.randrange(4)
    if what == 0:
        lines[k], lines[m] = lines[m], lines[k]
    elif what == 1:
        del lines[k]
    elif what == 2:
        lines[m:m] = [lines[k]] * draw.choice((1, 1, 50))
    else:
        lines[k] = lines[k][: draw.randrange(len(lines[k]) + 1)]
    return "\n".join(lines)


def _mark(text: str, draw: Random) -> str:
    places = [k for k, letter in enumerate(text) if not letter.isalnum()]
    if not places:
        return text
    place = draw.choice(places)
    return text[:place] + draw.choice("\"'`=,;:.[]{}<>#\\\t\n \r\x0c−") + text[place + 1 :]


TEXT_WAYS: tuple[Callable[[str, Random], str], ...] = (_number, _number, _insert, _nest, _lines, _mark)


def spoil_encoding(text: str, draw: Random) -> bytes:
    """Return a text spoilt, in one of several encodings, or with its bytes spoilt."""
    what = draw.randrange(10)
    if what == 0:
        return spoil_text(text, draw).encode("utf-16", "replace")
    if what == 1:
        return spoil_text(text, draw).encode("latin-1", "replace")
    if what <= 4:
        return spoil_bytes(text.encode(), draw)
    return spoil_text(text, draw).encode("utf-8", "surrogatepass")


def spoil_tree(tree: Any, draw: Random, values: tuple[Any, ...] = VALUES) -> Any:
    """Return a tree of dicts and lists with one to three places changed: a value, a key, one more or less."""
    tree = _copy(tree)
    for _ in range(draw.choice((1, 1, 2, 3))):
        places = list(_places(tree))
        if not places:
            return tree
        holder, key = draw.choice(places)
        what = draw.randrange(10)
        if what <= 6:
            holder[key] = draw.choice((*values, *TEXTS))
        elif what == 7:
            del holder[key]
        elif isinstance(holder, dict):
            holder[draw.choice(TEXTS)] = holder.pop(key)
        else:
            holder.extend(_copy(holder[key]) for _ in range(draw.choice((1, 200))))
    return tree


def _copy(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _copy(value) for key, value in tree.items()}
    return [_copy(value) for value in tree] if isinstance(tree, list) else tree


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        yield tree, key
        if isinstance(value, (dict, list)):
            yield from _places(value)
