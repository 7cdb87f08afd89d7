"""How fast the controller's own time passes for motions: the speed slider, pauses and stops."""

from __future__ import annotations

SLIDER_RATE = 2.0
"""How much of full speed the slider gains or loses in a second."""
PAUSE_RATE = 4.0
"""The same for a pause and for going on after it."""
STOP_RATE = 20.0
"""The same for a protective or emergency stop."""


class Pace:
    """Share of full speed; ``slider`` is the requested one."""

    def __init__(self) -> None:
        self.slider = 1.0
        self.now = 1.0
        """What motions run at: slider times hold."""
        self._slider_now = 1.0
        self._go = 1.0
        self._held = False
        self._rate = PAUSE_RATE

    @property
    def resumed(self) -> bool:
        """Whether nothing is held back any more."""
        return not self._held and self._go == 1.0

    def hold(self, held: bool, at_once: bool = False) -> None:
        """Slow down to rest, or go on again."""
        self._held = held
        self._rate = STOP_RATE if at_once else PAUSE_RATE

    def step(self, h: float) -> tuple[float, float]:
        """Let h (s) pass; return the share of full speed and how fast it changes, 1/s."""
        before = self.now
        self._slider_now = _nearer(self._slider_now, self.slider, SLIDER_RATE * h)
        self._go = _nearer(self._go, 0.0 if self._held else 1.0, self._rate * h)
        self.now = self._slider_now * self._go
        return self.now, (self.now - before) / h


def _nearer(now: float, wanted: float, step: float) -> float:
    return wanted if abs(wanted - now) <= step else now + step * (1.0 if wanted > now else -1.0)
