"""Numbers as programs, spreadsheets and people write them in text."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labhil.rig_sections import Table
from labhil.signals import FloatArray

MINUS = str.maketrans(dict.fromkeys("\u2212\u2013\ufe63\uff0d", "-"))
"""Characters that typesetting programs put in place of the minus: U+2212, the en dash, small, full width."""

BLANKS = str.maketrans(dict.fromkeys("\u00a0\u202f\u2009\u2007", " "))
"""Blanks that do not break a line, and thin ones: all of them group digits."""

APOSTROPHES = str.maketrans({"\u2019": "'"})

MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "."})
"""What programs write where there is no value (in lower case)."""


@dataclass(frozen=True)
class Notation:
    """How a file writes numbers: ``decimal`` mark, and what groups thousands (None: nothing does).

    A mark in another place than its own makes a text no number: ``1.234`` under a decimal comma is
    neither 1.234 nor 1234 unless the file says that the point groups thousands.
    """

    decimal: str = "."
    thousands: str | None = None

    @classmethod
    def of(cls, table: Table) -> Notation:
        """The notation that ``[table]`` of a rig file states."""
        return cls(table.decimal, table.thousands)

    def number(self, text: str) -> float:
        """The finite number that a text means, else NaN; in brackets it is negative, as in accounts."""
        plain = _plain(text)
        if plain.startswith("(") and plain.endswith(")"):
            inner = plain[1:-1].strip()
            return math.nan if inner[:1] in {"-", "+"} else -self._value(inner)
        return self._value(plain)

    def numbers(self, texts: Sequence[str]) -> FloatArray:
        """The numbers of many texts, shape (len(texts),); NaN where there is none."""
        everything = "\n".join(texts)
        if "_" not in everything and (self.decimal == "." or "." not in everything):
            quick = texts if self.decimal == "." else everything.replace(self.decimal, ".").split("\n")
            try:
                return np.array(list(map(float, quick)), dtype=np.float64)
            except ValueError:  # not all are numbers as Python writes them: each is read by itself
                pass
        number = self._with_point if self == Notation() else self.number
        return np.array([number(text) for text in texts], dtype=np.float64)

    def _with_point(self, text: str) -> float:
        """As :meth:`number`, faster where most texts are numbers of the usual kind."""
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
    """Whether a text stands for no value at all."""
    return text.strip().strip("\"'").lower() in MISSING


def other_notations(text: str, notation: Notation) -> list[tuple[Notation, str]]:
    """The notations in which a text is a number, each with the ``[table]`` keys that state it."""
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


def _plain(text: str) -> str:
    if text.isascii():
        return text.strip()
    return text.translate(MINUS).translate(BLANKS).translate(APOSTROPHES).strip()
