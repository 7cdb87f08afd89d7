"""Fading an excitation in and out, so that it begins and ends at rest."""

from __future__ import annotations

from dataclasses import dataclass

from labhil.experiment.excitation.function import Excitation, Excitations, columns_of


@dataclass(frozen=True, slots=True)
class Faded:
    """``offset`` + w(t)·(excitation − ``offset``).

    w goes from 0 to 1 in ``fade`` s, and back in the last ``fade`` s of ``duration``. It is the minimum-jerk
    polynomial 10u³ − 15u⁴ + 6u⁵ (Flash and Hogan 1985), whose first two derivatives are zero at both ends.
    """

    excitation: Excitation
    duration: float
    fade: float
    offset: float

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        u = min(max(min(t, self.duration - t) / self.fade, 0.0), 1.0)
        weight = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        return self.offset + weight * (self.excitation(t) - self.offset)


def apply_fade(
    excitation: Excitation | Excitations, duration: float, fade: float, offset: float = 0.0
) -> Excitation | Excitations:
    """Fade an excitation in and out, column by column.

    Args:
        excitation: A scalar or vector excitation.
        duration: Duration of the step, s.
        fade: Duration of each fade, s.
        offset: Value at which the excitation begins and ends, in its unit.

    Raises:
        ValueError: ``duration`` is shorter than both fades.
    """
    if 2 * fade > duration:
        raise ValueError(f"`fade` ({fade:g} s at either end) is more than `duration` ({duration:g} s)")
    columns = tuple(Faded(part, duration, fade, offset) for part in columns_of(excitation))
    return Excitations(columns) if isinstance(excitation, Excitations) else columns[0]
