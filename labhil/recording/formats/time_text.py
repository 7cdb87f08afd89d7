"""Dates and times of day in text, as seconds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from labhil.signals import FloatArray

DAY = 86400.0
_EPOCH = date(1970, 1, 1).toordinal()
CENTURY_OF_SHORT_YEARS = 2000
"""Century of a year with two digits."""

MONTHS = {
    **{"jan": 1, "feb": 2, "mar": 3, "apr": 4, "may": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9, "oct": 10},
    **{"nov": 11, "dec": 12, "mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12},
}

_CLOCK = (
    r"(?P<h>\d{1,4}):(?P<m>\d{2})(?::(?P<s>\d{2})(?:[.,:](?P<f>\d+))?)?(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_ZONE = r"(?:\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?))?"
_CLOCK_AND_ZONE = rf"(?:,?[T _]+{_CLOCK}{_ZONE})?"

_YMD = re.compile(rf"(?P<y>\d{{4}})([-/.])(?P<mo>\d{{1,2}})\2(?P<d>\d{{1,2}}){_CLOCK_AND_ZONE}")
_COMPACT = re.compile(
    rf"(?P<y>\d{{4}})(?P<mo>\d{{2}})(?P<d>\d{{2}})T(?P<h>\d{{2}})(?P<m>\d{{2}})(?P<s>\d{{2}})(?:[.,](?P<f>\d+))?{_ZONE}"
)
_POINTS = re.compile(rf"(?P<d>\d{{1,2}})\.(?P<mo>\d{{1,2}})\.(?P<y>\d{{4}}|\d{{2}}){_CLOCK_AND_ZONE}")
_DAY_FIRST = re.compile(rf"(?P<d>\d{{1,2}})([-/])(?P<mo>\d{{1,2}})\2(?P<y>\d{{4}}|\d{{2}}){_CLOCK_AND_ZONE}")
_MONTH_FIRST = re.compile(
    rf"(?P<mo>\d{{1,2}})([-/])(?P<d>\d{{1,2}})\2(?P<y>\d{{4}}|\d{{2}}){_CLOCK_AND_ZONE}"
)
_NAMED = re.compile(
    rf"(?P<d>\d{{1,2}})[-. ]+(?P<name>[A-Za-zä]{{3,9}})[-., ]+(?P<y>\d{{4}}){_CLOCK_AND_ZONE}"
)
_NAME_FIRST = re.compile(rf"(?P<name>[A-Za-zä]{{3,9}})\.? (?P<d>\d{{1,2}}),? (?P<y>\d{{4}}){_CLOCK_AND_ZONE}")
_OF_DAY = re.compile(rf"(?:(?P<days>\d+) days?,? )?{_CLOCK}")
_MINUTES = re.compile(r"(?P<m>\d{1,4}):(?P<s>\d{2})[.,](?P<f>\d+)")


class TimeKind(StrEnum):
    """Kinds of values of a column of times."""

    NUMBER = "number"
    DATE = "date and time"
    OF_DAY = "time of day"


@dataclass(frozen=True)
class TimeValues:
    """Times of a column.

    Attributes:
        values: (rows,), numbers in the unit of the file; dates in s of Unix time, times of day in s.
        kind: what they are.
    """

    values: FloatArray
    kind: TimeKind = TimeKind.NUMBER


class _Parser(NamedTuple):
    """A parser of one kind of texts."""

    kind: TimeKind
    patterns: tuple[re.Pattern[str], ...]
    seconds: Callable[[re.Match[str]], float]


def parse_times(texts: Sequence[str]) -> TimeValues | None:
    """Parse the texts of a column as dates or times of day.

    All texts are of one kind. Of both orders of day and month the one counts in which more texts are dates,
    and then the one with the shorter span of time.

    Args:
        texts: the texts.

    Returns:
        Times, UTC for dates without a zone; None if no text is a time.
    """
    stripped = [text.strip().strip("\"'").strip() for text in texts]
    best, best_rank = None, (0, -math.inf)
    for kind, patterns, seconds in _PARSERS:
        values = np.array([_parse(patterns, text, seconds) for text in stripped], dtype=np.float64)
        finite = values[np.isfinite(values)]
        if len(finite) and (rank := (len(finite), -float(np.ptp(finite)))) > best_rank:
            best, best_rank = TimeValues(values, kind), rank
        if len(finite) == len(stripped) and patterns is _UNAMBIGUOUS:
            break  # no ambiguous order of day and month: no other parser can be better
    return best


def is_time(text: str) -> bool:
    """Whether a text is a date or a time of day."""
    return parse_times([text]) is not None


def _parse(
    patterns: Sequence[re.Pattern[str]], text: str, seconds: Callable[[re.Match[str]], float]
) -> float:
    for pattern in patterns:
        if match := pattern.fullmatch(text):
            return seconds(match)
    return math.nan


def _date_seconds(match: re.Match[str]) -> float:
    fields = match.groupdict()
    month = MONTHS.get(fields["name"].lower()[:3], 0) if fields.get("name") else int(fields["mo"])
    year = int(fields["y"]) + (CENTURY_OF_SHORT_YEARS if len(fields["y"]) == 2 else 0)
    day = _day_seconds(year, month, int(fields["d"]))
    return day + _clock_seconds(fields) - _zone_seconds(fields.get("zone"))


def _time_of_day_seconds(match: re.Match[str]) -> float:
    fields = match.groupdict()
    if fields.get("s") is None and not fields.get("half"):
        return math.nan  # 12:30 is ambiguous: hours and minutes, or minutes and seconds
    return DAY * int(fields.get("days") or 0) + _clock_seconds(fields)


@lru_cache(maxsize=64)
def _day_seconds(year: int, month: int, day: int) -> float:
    try:
        return DAY * (date(year, month, day).toordinal() - _EPOCH)
    except ValueError:
        return math.nan


def _clock_seconds(fields: dict[str, str | None]) -> float:
    hours, half = int(fields.get("h") or 0), (fields.get("half") or "").lower()
    if half:
        hours = hours % 12 + (12 if half == "p" else 0)
    seconds = 3600 * hours + 60 * int(fields.get("m") or 0) + int(fields.get("s") or 0)
    return seconds + float(f"0.{fields.get('f') or 0}")


def _zone_seconds(zone: str | None) -> float:
    if zone is None or zone[0] not in "+-":
        return 0.0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return math.copysign(3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]), int(f"{zone[0]}1"))


_UNAMBIGUOUS = (_YMD, _COMPACT, _POINTS, _NAMED, _NAME_FIRST)
_PARSERS = (
    _Parser(TimeKind.DATE, _UNAMBIGUOUS, _date_seconds),
    _Parser(TimeKind.DATE, (_DAY_FIRST,), _date_seconds),
    _Parser(TimeKind.DATE, (_MONTH_FIRST,), _date_seconds),
    _Parser(TimeKind.OF_DAY, (_OF_DAY, _MINUTES), _time_of_day_seconds),
)
