"""A root between two places, narrowed from the better side (Anderson and Björck 1973)."""

from __future__ import annotations

from typing import NamedTuple

from labhil.compiled import inlined

LEAST = 1e-6
"""Share of a bracket that is cut off at least."""


class Bracket(NamedTuple):
    """Two places with values of opposite sign; ``moved`` is the end that was moved last, −1 or +1."""

    low: float
    at_low: float
    high: float
    at_high: float
    moved: float


@inlined
def crossing(b: Bracket) -> float:
    """Where the straight line between both ends is zero, never an end itself."""
    share = b.at_low / (b.at_low - b.at_high)
    return b.low + min(max(share, LEAST), 1.0 - LEAST) * (b.high - b.low)


@inlined
def narrow(b: Bracket, place: float, value: float) -> Bracket:
    """The bracket with the end moved to ``place`` whose sign ``value`` has.

    An end that is kept twice counts for less by how much the value at the other one fell, or it would
    never move.
    """
    if (value > 0.0) == (b.at_low > 0.0):
        kept = b.at_high * _share(value, b.at_low) if b.moved < 0.0 else b.at_high
        return Bracket(place, value, b.high, kept, -1.0)
    kept = b.at_low * _share(value, b.at_high) if b.moved > 0.0 else b.at_low
    return Bracket(b.low, kept, place, value, 1.0)


@inlined
def _share(value: float, before: float) -> float:
    fell = 1.0 - value / before
    return fell if fell > 0.0 else 0.5
