"""Numbers as people write them: four significant digits, a true minus sign, powers of ten, units."""

from __future__ import annotations

import math

NOTHING = "–"
SMALLEST_P = 1e-99

THOUSANDS = (1e4, 1e7)
"""Sizes that are written out, with spaces between thousands."""

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def squared(unit: str) -> str:
    """The square of a unit: ``m²``, ``(rad/s)²``; nothing of none."""
    if unit in ("", "1"):
        return ""
    return f"{unit}²" if unit.isalpha() else f"({unit})²"


def quantity(value: float | None, unit: str = "", digits: int = 4) -> str:
    """A number with its unit, ``−0.06 N``; a dash where there is none. A unit of 1 is not written."""
    if value is None or not math.isfinite(value):
        return NOTHING
    if THOUSANDS[0] <= abs(value) < THOUSANDS[1]:
        rounded = round(float(f"{value:.{digits}g}"))
        return _with_unit(count(rounded).replace("-", "−"), unit)
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    power = f"·10{str(int(exponent)).translate(SUPERSCRIPTS)}" if exponent else ""
    return _with_unit(mantissa.replace("-", "−") + power, unit)


def _with_unit(number: str, unit: str) -> str:
    return f"{number}\N{NO-BREAK SPACE}{unit}" if unit not in ("", "1") else number


def interval(ends: tuple[float | None, float | None] | None, unit: str = "") -> str:
    """``0.05 to 0.07 N``; a dash where an end is not known."""
    if ends is None:
        return NOTHING
    low, high = ends
    return f"{quantity(low)} to {quantity(high, unit)}"


def percent(share: float | None) -> str:
    """A fraction in per cent: two decimals, or four where two would make a whole of what is none."""
    if share is None or not math.isfinite(share):
        return NOTHING
    decimals = 4 if 0.99995 <= share < 1.0 else 2
    return f"{100 * share:.{decimals}f}\N{NO-BREAK SPACE}%".replace("-", "−")


def chance(probability: float | None) -> str:
    """A probability in whole per cent; near its ends as a bound, since nothing is certain."""
    if probability is None or not math.isfinite(probability):
        return NOTHING
    if probability > 0.99:
        return ">\N{NO-BREAK SPACE}99\N{NO-BREAK SPACE}%"
    if probability < 0.01:
        return "<\N{NO-BREAK SPACE}1\N{NO-BREAK SPACE}%"
    return f"{100 * probability:.0f}\N{NO-BREAK SPACE}%"


def p_value(value: float | None) -> str:
    """A p value, two digits."""
    if value is not None and value < SMALLEST_P:
        return "<\N{NO-BREAK SPACE}10⁻⁹⁹"
    return quantity(value, digits=2)


def multiple(value: float | None, unit: float | None) -> str:
    """``133 ×``: how many times ``unit`` a value is."""
    if value is None or not unit:
        return NOTHING
    return f"{quantity(value / unit, digits=3)}\N{NO-BREAK SPACE}×"


def count(number: int) -> str:
    """A whole number with narrow spaces between thousands."""
    return f"{number:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
