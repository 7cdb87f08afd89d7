"""Bracketing of a root by false position with the weights of Anderson and Björck (1973)."""

from __future__ import annotations

from typing import NamedTuple

from labhil.compiled import inlined

MIN_CUT = 1e-6
"""Least share of a bracket that one step cuts off."""


class Bracket(NamedTuple):
    """Two abscissas with values of opposite sign; ``moved`` is the end that moved last, −1 or +1."""

    low: float
    at_low: float
    high: float
    at_high: float
    moved: float


@inlined
def false_position(b: Bracket) -> float:
    """Root of the straight line through both ends, kept away from the ends."""
    share = b.at_low / (b.at_low - b.at_high)
    return b.low + min(max(share, MIN_CUT), 1.0 - MIN_CUT) * (b.high - b.low)


@inlined
def narrow(b: Bracket, place: float, value: float) -> Bracket:
    """Move the end with the sign of ``value`` to ``place``.

    The value at an end that is kept twice in a row is reduced, or that end would never move.
    """
    if (value > 0.0) == (b.at_low > 0.0):
        kept = b.at_high * _retained_weight(value, b.at_low) if b.moved < 0.0 else b.at_high
        return Bracket(place, value, b.high, kept, -1.0)
    kept = b.at_low * _retained_weight(value, b.at_high) if b.moved > 0.0 else b.at_low
    return Bracket(b.low, kept, place, value, 1.0)


@inlined
def _retained_weight(value: float, before: float) -> float:
    """Factor on the value at the kept end."""
    fell = 1.0 - value / before
    return fell if fell > 0.0 else 0.5
