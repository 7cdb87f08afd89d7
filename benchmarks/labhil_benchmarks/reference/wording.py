"""Numbers and cells as people read them, for the terminal and for the page."""

from __future__ import annotations

from labhil.physics.terms import keyed
from labhil_benchmarks.reference.result import Figure, Row

NONE = "–"


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits; powers of ten in words where it is very small or large."""
    if value is None:
        return NONE
    if value == 0.0:
        return "0"
    if not abs(value) < float("inf"):
        return "∞"
    text = f"{value:.{digits}g}"
    mantissa, e, power = text.partition("e")
    return f"{mantissa}·10^{int(power)}" if e else text.replace("-", "−")


def percent(value: float | None) -> str:
    """A share in %, with its sign."""
    if value is None:
        return ""
    if abs(value) >= 1000.0:
        return f"{'−' if value < 0 else '+'}>1000 %"
    return f"{value:+.1f} %".replace("-", "−")


def bounds(value: float | None) -> str:
    """An error in Cramér-Rao bounds."""
    if value is None:
        return ""
    if abs(value) >= 1000.0:
        return f"{'−' if value < 0 else '+'}>1000 σ"
    return f"{value:+.1f} σ".replace("-", "−")


def label(row: Row) -> str:
    """Symbol with the joint in brackets."""
    return keyed(row.symbol, row.joint)


def bound_of(row: Row) -> str:
    """The bound, in the row's unit and in % of the truth."""
    if row.bound is None:
        return "none"
    share = f" ({number(100.0 * row.bound / abs(row.truth), 2)} %)" if row.truth else ""
    return number(row.bound, 3) + share


def figure_of(figure: Figure | None) -> tuple[str, str]:
    """A value, and its error in % and in bounds."""
    if figure is None:
        return NONE, ""
    errors = [text for text in (percent(figure.error), bounds(figure.in_bounds)) if text]
    return number(figure.value), ", ".join(errors)


def interval(ends: tuple[float, float] | None, truth: float) -> str:
    """An interval, marked where the truth is not in it."""
    if ends is None:
        return NONE
    missed = "" if ends[0] <= truth <= ends[1] else " ✗"
    return f"[{number(ends[0], 3)}, {number(ends[1], 3)}]{missed}"
