"""Texts made at random out of what a format is made of: most are wrong, some are right."""

from __future__ import annotations

import json
from random import Random
from typing import Any

from labhil_benchmarks.bad_files.spoil import NUMBERS, TEXTS, VALUES

_HEADERS = ("t", "time", "servo_angle", "ball_position", "ball_position [mm]", "t (s)", "0", "")
_CELLS = (*NUMBERS, "1.5", "-0.25", "0.5", "1,5", "1.234,5", "2026-05-31", "10:00:00.5", "", "−1", "(1)", "#")
_ENCODINGS = ("utf-8", "utf-8", "utf-8-sig", "utf-16", "utf-16-le", "latin-1")


def random_csv(draw: Random) -> bytes:
    """Return a table of random headers and cells, with random marks between them."""
    mark = draw.choice((",", ",", ";", "\t", " "))
    width = draw.choice((1, 2, 3, 3, 3, 8, 300))
    lines = [mark.join(draw.choice((*_HEADERS, *_HEADERS, *TEXTS)) for _ in range(width))]
    wild = draw.choice((0.0, 0.02, 0.3, 1.0))
    for k in range(draw.choice((0, 1, 2, 30, 30, 200))):
        cells = [f"{k / 20}", f"{draw.uniform(-1, 1):.4f}", f"{draw.uniform(-0.2, 0.2):.4f}"]
        cells = (cells * (width // 3 + 1))[:width]
        lines.append(mark.join(_cell(draw) if draw.random() < wild else cell for cell in cells))
    text = draw.choice(("\n", "\n", "\r\n", "\r")).join(lines)
    return text.encode(draw.choice(_ENCODINGS), "replace")


def _cell(draw: Random) -> str:
    cell = draw.choice((*_CELLS, *TEXTS))
    return f'"{cell}"' if draw.random() < 0.2 else cell


def random_toml(draw: Random, whole: str) -> bytes:
    """Return lines of a TOML file in another order, with other values, some twice, some left out."""
    lines = whole.splitlines()
    new = []
    for line in lines:
        if draw.random() < 0.1:
            continue
        key, equals, _ = line.partition("=")
        other = f"{key}= {_toml_value(draw)}" if equals and draw.random() < 0.15 else line
        new += [other] * (2 if draw.random() < 0.03 else 1)
    if draw.random() < 0.2:
        draw.shuffle(new)
    return "\n".join(new).encode("utf-8", "replace")


def _toml_value(draw: Random) -> str:
    if draw.random() < 0.5:
        return draw.choice((*NUMBERS[:12], "true", "[]", "{}", "[[1, 2], [3]]", "1979-05-27", "{ a = 1 }"))
    return json.dumps(draw.choice(TEXTS)).replace("\\u0000", "\\u0001").replace("\\u007f", "")


def random_json(draw: Random, original: Any) -> bytes:
    """Return the keys of a tree with values at random, or a tree of random values."""
    if isinstance(original, dict):
        tree = {key: value if draw.random() < 0.7 else _value(draw, 3) for key, value in original.items()}
        return json.dumps(tree).encode()
    return json.dumps(_value(draw, 4)).encode()


def _value(draw: Random, depth: int) -> Any:
    if depth and draw.random() < 0.5:
        inner = [_value(draw, depth - 1) for _ in range(draw.randrange(4))]
        return inner if draw.random() < 0.5 else {draw.choice(TEXTS): one for one in inner}
    return draw.choice((*VALUES, *TEXTS))
