"""Numbers as text: significant digits, a true minus sign, powers of ten, units.

Pages and the screen use the forms with typographic spaces and signs, tables in a terminal the ASCII ones at
the end of the file.
"""

from __future__ import annotations

import math
import re

NOTHING = "–"
SMALLEST_P = 1e-99
SIGNIFICANCE = 0.01
"""Probability below which a report says that a test refutes what it assumes."""

THOUSANDS = (1e4, 1e7)
"""Sizes that are written out, with spaces between thousands."""

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def square_unit(unit: str) -> str:
    """Return the square of a unit: ``m²``, ``(rad/s)²``; empty for no unit."""
    if unit in ("", "1"):
        return ""
    return f"{unit}²" if unit.isalpha() else f"({unit})²"


def format_quantity(value: float | None, unit: str = "", digits: int = 4) -> str:
    """Format a number with its unit, ``−0.06 N``.

    Args:
        value: The number; None and numbers that are not finite become a dash.
        unit: Its unit; empty or 1 is not written.
        digits: Significant digits.
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    if THOUSANDS[0] <= abs(value) < THOUSANDS[1]:
        rounded = round(float(f"{value:.{digits}g}"))
        return _with_unit(format_count(rounded).replace("-", "−"), unit)
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    power = f"·10{_power(exponent)}" if exponent else ""
    return _with_unit(mantissa.replace("-", "−") + power, unit)


def format_powers(sentence: str) -> str:
    """Write the powers of ten of a sentence as the tables of a page do: ``1.8·10⁻⁵`` for ``1.8e-05``."""
    sentence = re.sub(r"< ?1e(-\d+)", lambda found: f"<\N{NO-BREAK SPACE}10{_power(found[1])}", sentence)
    return re.sub(r"(?<=\d)e([+-]\d+)", lambda found: f"·10{_power(found[1])}", sentence)


def _power(exponent: str) -> str:
    return str(int(exponent)).translate(SUPERSCRIPTS)


def _with_unit(number: str, unit: str) -> str:
    return f"{number}\N{NO-BREAK SPACE}{unit}" if unit not in ("", "1") else number


def format_interval(ends: tuple[float | None, float | None] | None, unit: str = "") -> str:
    """Format an interval, ``0.05 to 0.07 N``; a dash for an end that is not known."""
    if ends is None:
        return NOTHING
    low, high = ends
    return f"{format_quantity(low)} to {format_quantity(high, unit)}"


def format_percent(share: float | None) -> str:
    """Format a fraction in per cent, with two decimals, or four where two would round it up to 100 %."""
    if share is None or not math.isfinite(share):
        return NOTHING
    decimals = 4 if 0.99995 <= share < 1.0 else 2
    return f"{100 * share:.{decimals}f}\N{NO-BREAK SPACE}%".replace("-", "−")


def format_probability(probability: float | None) -> str:
    """Format a probability in whole per cent, or as a bound beyond 1 and 99 %."""
    if probability is None or not math.isfinite(probability):
        return NOTHING
    if probability > 0.99:
        return ">\N{NO-BREAK SPACE}99\N{NO-BREAK SPACE}%"
    if probability < 0.01:
        return "<\N{NO-BREAK SPACE}1\N{NO-BREAK SPACE}%"
    return f"{100 * probability:.0f}\N{NO-BREAK SPACE}%"


def format_p_value(value: float | None) -> str:
    """Format a p value with two digits."""
    if value is not None and value < SMALLEST_P:
        return "<\N{NO-BREAK SPACE}10⁻⁹⁹"
    return format_quantity(value, digits=2)


def format_multiple(value: float | None, unit: float | None) -> str:
    """Format how many times ``unit`` a value is: ``133 ×``."""
    if value is None or not unit:
        return NOTHING
    return f"{format_quantity(value / unit, digits=3)}\N{NO-BREAK SPACE}×"


def format_count(number: int | None) -> str:
    """Format a whole number with narrow spaces between thousands."""
    return NOTHING if number is None else f"{number:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def format_number(value: float | None, format_spec: str) -> str:
    """Format a number with a format specification such as ``.4g``; None is a dash."""
    return NOTHING if value is None else f"{value:{format_spec}}"


def format_p(probability: float | None) -> str:
    """Format a p value for a table in a terminal: ``0.03``, ``<1e-99``; None is a dash."""
    if probability is None:
        return NOTHING
    return "<1e-99" if probability < SMALLEST_P else f"{probability:.2g}"


def is_refuted(probability: float | None) -> bool:
    """Whether a test refutes what it assumes; False where nothing was tested."""
    return probability is not None and probability < SIGNIFICANCE


def format_p_relation(probability: float | None) -> str:
    """Format what follows "p" in a sentence: ``= 0.03``, ``<1e-99``; None is a dash."""
    text = format_p(probability)
    return text if text == NOTHING or text.startswith("<") else f"= {text}"
