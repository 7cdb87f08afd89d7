"""Dates and times of day that stand in a table as text, as seconds."""

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
EPOCH = date(1970, 1, 1).toordinal()
CENTURY = 2000
"""A year of two digits is one of this century: recordings of the last one are not in such files."""

MONTHS = {
    **{"jan": 1, "feb": 2, "mar": 3, "apr": 4, "may": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9, "oct": 10},
    **{"nov": 11, "dec": 12, "mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12},
}

CLOCK = r"(?P<h>\d{1,4}):(?P<m>\d{2})(?::(?P<s>\d{2})(?:[.,:](?P<f>\d+))?)?(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
ZONE = r"(?:\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?))?"
REST = rf"(?:,?[T _]+{CLOCK}{ZONE})?"

_YMD = re.compile(rf"(?P<y>\d{{4}})([-/.])(?P<mo>\d{{1,2}})\2(?P<d>\d{{1,2}}){REST}")
_COMPACT = re.compile(
    rf"(?P<y>\d{{4}})(?P<mo>\d{{2}})(?P<d>\d{{2}})T(?P<h>\d{{2}})(?P<m>\d{{2}})(?P<s>\d{{2}})(?:[.,](?P<f>\d+))?{ZONE}"
)
_POINTS = re.compile(rf"(?P<d>\d{{1,2}})\.(?P<mo>\d{{1,2}})\.(?P<y>\d{{4}}|\d{{2}}){REST}")
_DAY_FIRST = re.compile(rf"(?P<d>\d{{1,2}})([-/])(?P<mo>\d{{1,2}})\2(?P<y>\d{{4}}|\d{{2}}){REST}")
_MONTH_FIRST = re.compile(rf"(?P<mo>\d{{1,2}})([-/])(?P<d>\d{{1,2}})\2(?P<y>\d{{4}}|\d{{2}}){REST}")
_NAMED = re.compile(rf"(?P<d>\d{{1,2}})[-. ]+(?P<name>[A-Za-zä]{{3,9}})[-., ]+(?P<y>\d{{4}}){REST}")
_NAME_FIRST = re.compile(rf"(?P<name>[A-Za-zä]{{3,9}})\.? (?P<d>\d{{1,2}}),? (?P<y>\d{{4}}){REST}")
_OF_DAY = re.compile(rf"(?:(?P<days>\d+) days?,? )?{CLOCK}")
_MINUTES = re.compile(r"(?P<m>\d{1,4}):(?P<s>\d{2})[.,](?P<f>\d+)")


class TimeKind(StrEnum):
    """What the texts of a time column are."""

    NUMBER = "number"
    DATE = "date and time"
    OF_DAY = "time of day"


@dataclass(frozen=True)
class TimeValues:
    """Times (rows,) of a column: numbers as they stand, or seconds where they are dates or times of day."""

    values: FloatArray
    kind: TimeKind = TimeKind.NUMBER


class _Reading(NamedTuple):
    """One way to read the texts of a column."""

    kind: TimeKind
    patterns: tuple[re.Pattern[str], ...]
    seconds: Callable[[re.Match[str]], float]


def parse_times(texts: Sequence[str]) -> TimeValues | None:
    """Read the texts of a column as dates (s of Unix time, UTC where no zone is given) or times of day (s).

    All texts are read in one way. Of two orders of day and month the one counts in which more of them are
    dates, and of two such the one in which they span less time. None where no text is a time.
    """
    plain = [text.strip().strip("\"'").strip() for text in texts]
    best, best_rank = None, (0, -math.inf)
    for kind, patterns, seconds in _READINGS:
        values = np.array([_first(patterns, text, seconds) for text in plain], dtype=np.float64)
        known = values[np.isfinite(values)]
        if len(known) and (rank := (len(known), -float(np.ptp(known)))) > best_rank:
            best, best_rank = TimeValues(values, kind), rank
        if len(known) == len(plain) and patterns is _ONE_ORDER:
            break  # one order of day and month only: no other reading can be better
    return best


def is_time(text: str) -> bool:
    """Whether a text is a date or a time of day."""
    return parse_times([text]) is not None


def _first(
    patterns: Sequence[re.Pattern[str]], text: str, seconds: Callable[[re.Match[str]], float]
) -> float:
    for pattern in patterns:
        if match := pattern.fullmatch(text):
            return seconds(match)
    return math.nan


def _of_date(match: re.Match[str]) -> float:
    part = match.groupdict()
    month = MONTHS.get(part["name"].lower()[:3], 0) if part.get("name") else int(part["mo"])
    year = int(part["y"]) + (CENTURY if len(part["y"]) == 2 else 0)
    day = _midnight(year, month, int(part["d"]))
    return day + _clock(part) - _zone(part.get("zone"))


def _of_day(match: re.Match[str]) -> float:
    part = match.groupdict()
    if part.get("s") is None and not part.get("half"):
        return math.nan  # 12:30 alone: hours and minutes, or minutes and seconds?
    return DAY * int(part.get("days") or 0) + _clock(part)


@lru_cache(maxsize=64)
def _midnight(year: int, month: int, day: int) -> float:
    try:
        return DAY * (date(year, month, day).toordinal() - EPOCH)
    except ValueError:
        return math.nan


def _clock(part: dict[str, str | None]) -> float:
    hours, half = int(part.get("h") or 0), (part.get("half") or "").lower()
    if half:
        hours = hours % 12 + (12 if half == "p" else 0)
    whole = 3600 * hours + 60 * int(part.get("m") or 0) + int(part.get("s") or 0)
    return whole + float(f"0.{part.get('f') or 0}")


def _zone(zone: str | None) -> float:
    if zone is None or zone[0] not in "+-":
        return 0.0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return math.copysign(3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]), int(f"{zone[0]}1"))


_ONE_ORDER = (_YMD, _COMPACT, _POINTS, _NAMED, _NAME_FIRST)
_READINGS = (
    _Reading(TimeKind.DATE, _ONE_ORDER, _of_date),
    _Reading(TimeKind.DATE, (_DAY_FIRST,), _of_date),
    _Reading(TimeKind.DATE, (_MONTH_FIRST,), _of_date),
    _Reading(TimeKind.OF_DAY, (_OF_DAY, _MINUTES), _of_day),
)
