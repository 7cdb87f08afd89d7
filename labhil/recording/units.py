"""Units in tables: in a line below the header, or in the names of columns."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple


class Unit(NamedTuple):
    """A unit: value in the internal unit ``quantity`` = value · ``scale`` + ``offset``."""

    quantity: str
    scale: float
    offset: float = 0.0


TURN = 2.0 * math.pi
DEGREE = math.pi / 180.0
PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3}
PREFIXABLE = {"V": "V", "A": "A", "m": "m", "N": "N", "Nm": "N·m", "s": "s", "rad": "rad", "m/s": "m/s"}
INTERNAL_UNITS = {"V", "A", "m", "N", "N·m", "s", "rad", "rad/s", "m/s", "m/s²", "rad/s²", "°C"}


def _build_units() -> Mapping[str, Unit]:
    units = {name: Unit(ours, 1.0) for name, ours in PREFIXABLE.items()}
    for prefix, factor in PREFIXES.items():
        units |= {f"{prefix}{name}": Unit(ours, factor) for name, ours in PREFIXABLE.items()}
    for names, quantity, scale in (
        ("sec secs second seconds", "s", 1.0),
        ("msec msecs millis millisecond milliseconds", "s", 1e-3),
        ("usec usecs micros microsecond microseconds", "s", 1e-6),
        ("nsec nanosecond nanoseconds", "s", 1e-9),
        ("min mins minute minutes", "s", 60.0),
        ("h hr hrs hour hours", "s", 3600.0),
        ("d day days", "s", 86400.0),
        ("volt volts", "V", 1.0),
        ("amp amps ampere amperes", "A", 1.0),
        ("in inch inches", "m", 0.0254),
        ("radian radians", "rad", 1.0),
        ("deg degree degrees", "rad", DEGREE),
        ("rev revs turn turns", "rad", TURN),
        ("rad/s rad/sec rads-1", "rad/s", 1.0),
        ("mrad/s", "rad/s", 1e-3),
        ("deg/s deg/sec dps", "rad/s", DEGREE),
        ("rpm r/min rev/min 1/min min-1 u/min", "rad/s", TURN / 60.0),
        ("rps rev/s 1/s Hz", "rad/s", TURN),
        ("m/min", "m/s", 1.0 / 60.0),
        ("mm/min", "m/s", 1e-3 / 60.0),
        ("rad/s2 rad/s/s", "rad/s²", 1.0),
        ("deg/s2 deg/s/s", "rad/s²", DEGREE),
        ("m/s2", "m/s²", 1.0),
        ("mm/s2", "m/s²", 1e-3),
        ("Nmm", "N·m", 1e-3),
        ("Ncm", "N·m", 1e-2),
        ("C degC celsius", "°C", 1.0),
    ):
        units |= dict.fromkeys(names.split(), Unit(quantity, scale))
    units["K"] = units["kelvin"] = Unit("°C", 1.0, -273.15)
    units["F"] = units["degF"] = Unit("°C", 5.0 / 9.0, -160.0 / 9.0)
    return units


UNITS = _build_units()

ROTARY_EQUIVALENTS = {"m": "rad", "m/s": "rad/s", "N": "N·m"}
"""Units on a rotary axis in the place of those on a linear axis."""

_BRACKETED_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]+)[\])]\s*$")
_UNIT_SUFFIX = re.compile(r"^(?P<name>.+?)(?:_|-|/| in |\s)(?P<unit>[^_\s/-]+(?:/s)?)$")

UNAMBIGUOUS_UNITS = {
    "ms",
    "us",
    "µs",
    "μs",
    "ns",
    "mm",
    "cm",
    "rpm",
    "deg",
    "mA",
    "mV",
    "msec",
    "deg/s",
    "rad/s",
}
"""Units that count without brackets at the end of a name; ``_s``, ``_a``, ``_min`` are ambiguous."""


def parse_unit(text: str) -> Unit | None:
    """Parse a unit, with or without brackets; None if it is unknown."""
    plain = text.strip().strip("\"'").strip().strip("[](){}").strip()
    if plain in UNITS:
        return UNITS[plain]
    plain = plain.replace("µ", "u").replace("μ", "u").replace("°", "deg").replace("²", "2").replace("^", "")
    plain = re.sub(r"[·⋅*\s]", "", plain)
    plain = plain.replace("degdeg", "deg")
    return UNITS.get(plain) or (UNITS.get(plain.lower()) if len(plain) > 2 else None)


def unit_in_name(name: str) -> tuple[str, Unit] | None:
    """Text and unit in a column's name, like ``time [ms]``, ``speed (rpm)``, ``pot_mm``; None without."""
    name = name.strip()
    if match := _BRACKETED_UNIT.match(name):
        unit = parse_unit(match["unit"])
        return (match["unit"].strip(), unit) if unit else None
    if name in UNAMBIGUOUS_UNITS and (unit := parse_unit(name)):
        return name, unit
    if (
        (match := _UNIT_SUFFIX.match(name))
        and match["unit"] in UNAMBIGUOUS_UNITS
        and (unit := parse_unit(match["unit"]))
    ):
        return match["unit"], unit
    return None


def without_unit(name: str) -> str:
    """Name of a column without its unit: ``time`` of ``time [ms]`` and ``time_ms``."""
    plain = name.strip()
    match = _BRACKETED_UNIT.match(plain) or _UNIT_SUFFIX.match(plain)
    return match["name"] if match and match["name"] and unit_in_name(plain) else name


def is_units_line(texts: Sequence[str]) -> bool:
    """Whether a line contains units: one known unit, and otherwise known units or texts in brackets.

    Args:
        texts: fields of the line, of which empty ones are ignored.

    Returns:
        Whether they are units; False if there is any number.
    """
    filled = [text.strip().strip("\"'").strip() for text in texts]
    filled = [text for text in filled if text and text not in {"-", "1", "%"}]
    bracketed = [text[:1] in "[(" and text[-1:] in "])" for text in filled]
    known = [parse_unit(text) is not None for text in filled]
    numbers = [bool(re.fullmatch(r"[\[(]?[\d.,+-]+[\])]?", text)) for text in filled]
    return any(known) and not any(numbers) and all(a or b for a, b in zip(bracketed, known, strict=True))
