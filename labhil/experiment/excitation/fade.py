"""An excitation that begins and ends at rest: it grows from a value, and dies away to it."""

from __future__ import annotations

from dataclasses import dataclass

from labhil.experiment.excitation.function import Excitation, Excitations, columns_of


@dataclass(frozen=True, slots=True)
class Faded:
    """``about`` + w(t)·(excitation − ``about``).

    w goes from 0 to 1 in ``fade`` s, and back in the last ``fade`` s of ``duration``; it is
    10u³ − 15u⁴ + 6u⁵, whose first two derivatives are zero at both ends.
    """

    excitation: Excitation
    duration: float
    fade: float
    about: float

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        u = min(max(min(t, self.duration - t) / self.fade, 0.0), 1.0)
        share = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        return self.about + share * (self.excitation(t) - self.about)


def apply_fade(
    excitation: Excitation | Excitations, duration: float, fade: float, about: float = 0.0
) -> Excitation | Excitations:
    """Fade an excitation, or each of a vector's; ValueError when it is too short for that."""
    if 2 * fade > duration:
        raise ValueError(f"`fade` ({fade:g} s at either end) is more than `duration` ({duration:g} s)")
    columns = tuple(Faded(part, duration, fade, about) for part in columns_of(excitation))
    return Excitations(columns) if isinstance(excitation, Excitations) else columns[0]
