"""The speed of motion time relative to real time: speed slider, pauses and stops."""

from __future__ import annotations

SLIDER_RATE = 2.0
"""Rate at which the slider changes the speed, 1/s."""
PAUSE_RATE = 4.0
"""Rate at which a pause and its end change the speed, 1/s."""
STOP_RATE = 20.0
"""Rate at which a protective or emergency stop changes the speed, 1/s."""


class Pace:
    """The present share of full speed; ``slider`` is the requested share."""

    def __init__(self) -> None:
        self.slider = 1.0
        self.factor = 1.0
        """The share of full speed: slider times hold."""
        self._slider_factor = 1.0
        self._hold_factor = 1.0
        self._is_held = False
        self._rate = PAUSE_RATE

    @property
    def resumed(self) -> bool:
        """Whether motions are not held any more."""
        return not self._is_held and self._hold_factor == 1.0

    def hold(self, is_held: bool, fast: bool = False) -> None:
        """Come to rest, or resume; ``fast`` with the rate of a stop."""
        self._is_held = is_held
        self._rate = STOP_RATE if fast else PAUSE_RATE

    def step(self, h: float) -> tuple[float, float]:
        """Advance by h (s); return the share of full speed and its rate, 1/s."""
        previous = self.factor
        self._slider_factor = _step_towards(self._slider_factor, self.slider, SLIDER_RATE * h)
        self._hold_factor = _step_towards(self._hold_factor, 0.0 if self._is_held else 1.0, self._rate * h)
        self.factor = self._slider_factor * self._hold_factor
        return self.factor, (self.factor - previous) / h


def _step_towards(factor: float, target: float, step: float) -> float:
    return target if abs(target - factor) <= step else factor + step * (1.0 if target > factor else -1.0)
