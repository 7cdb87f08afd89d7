"""Notations of numbers in text, by programs, spreadsheets and people."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labhil.rig_sections import Table
from labhil.signals import FloatArray

MINUS = str.maketrans(dict.fromkeys("\u2212\u2013\ufe63\uff0d", "-"))
"""Substitutes of the minus: U+2212, en dash, small and full-width hyphen-minus."""

BLANKS = str.maketrans(dict.fromkeys("\u00a0\u202f\u2009\u2007", " "))
"""No-break and thin spaces, which group digits."""

APOSTROPHES = str.maketrans({"\u2019": "'"})

MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "."})
"""Texts that stand for a missing value, in lower case."""


@dataclass(frozen=True)
class Notation:
    """Notation of the numbers in a file.

    A text with a wrong mark is no number: ``1.234`` under a decimal comma is neither 1.234 nor 1234, unless
    ``thousands`` is the point.

    Attributes:
        decimal: decimal mark.
        thousands: separator of thousands; None without one.
    """

    decimal: str = "."
    thousands: str | None = None

    @classmethod
    def of(cls, table: Table) -> Notation:
        """Notation by ``[table]`` of a rig file."""
        return cls(table.decimal, table.thousands)

    def number(self, text: str) -> float:
        """Parse a number; NaN if it is none. In brackets it is negative, as in accounting."""
        plain = _normalise(text)
        if plain.startswith("(") and plain.endswith(")"):
            inner = plain[1:-1].strip()
            return math.nan if inner[:1] in {"-", "+"} else -self._value(inner)
        return self._value(plain)

    def numbers(self, texts: Sequence[str]) -> FloatArray:
        """Parse n texts; returns numbers (n,), NaN where a text is none."""
        joined = "\n".join(texts)
        if "_" not in joined and (self.decimal == "." or "." not in joined):
            python_texts = texts if self.decimal == "." else joined.replace(self.decimal, ".").split("\n")
            # A column with any other text is parsed text by text below. What is no number there becomes NaN,
            # and find_bad_rows reports its line, its text and the notation in which it is one.
            with suppress(ValueError):
                return np.array(list(map(float, python_texts)), dtype=np.float64)
        number = self._with_point if self == Notation() else self.number
        return np.array([number(text) for text in texts], dtype=np.float64)

    def _with_point(self, text: str) -> float:
        """Same as :meth:`number`, but faster for numbers in Python's notation."""
        try:
            return float(text) if "_" not in text else math.nan
        except ValueError:
            return self.number(text)

    def _value(self, plain: str) -> float:
        match = self._pattern.fullmatch(plain)
        if match is None:
            return math.nan
        sign, integer, fraction, exponent, minus_behind = match.groups(default="")
        if sign and minus_behind:
            return math.nan
        digits = integer.replace(self.thousands, "") if self.thousands else integer
        value = float(f"{digits or '0'}.{fraction or '0'}e{exponent or '0'}")
        return -value if "-" in (sign, minus_behind) else value

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        integer, mark = r"\d+", re.escape(self.decimal)
        if self.thousands:
            integer = rf"\d{{1,3}}(?:{re.escape(self.thousands)}\d{{3}})+|\d+"
        return re.compile(
            rf"([+-]?) ?(?=\d|{mark}\d)({integer})?(?:{mark}(\d*))?(?:[eEdD]([+-]?\d+))?(-?)", re.ASCII
        )


def is_missing(text: str) -> bool:
    """Whether a text stands for a missing value."""
    return text.strip().strip("\"'").lower() in MISSING


def other_notations(text: str, notation: Notation) -> list[tuple[Notation, str]]:
    """Notations in which a text is a number, each with a hint which ``[table]`` keys select it."""
    notations = []
    for decimal in (".", ","):
        for thousands in (None, ".", ",", "'", " "):
            candidate = Notation(decimal, thousands)
            if thousands != decimal and math.isfinite(value := candidate.number(text)):
                keys = [] if decimal == notation.decimal else [f'decimal = "{decimal}"']
                keys += [f'thousands = "{thousands}"'] if thousands else []
                notations.append((candidate, f"with [table] {' and '.join(keys)} it is {value:.12g}"))
                break
    return notations


def _normalise(text: str) -> str:
    if text.isascii():
        return text.strip()
    return text.translate(MINUS).translate(BLANKS).translate(APOSTROPHES).strip()
