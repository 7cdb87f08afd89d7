"""How a rig with one input is driven: a controller on its first output, and an excitation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.signals import FloatArray

Range = tuple[float, float]

SLOPE_LAG = 0.03
"""Time constant (s) of the controllers' derivative."""

FADED_IN = 0.02
"""Share of a recording in which an excitation grows from its centre to its full size.

No recording holds what stood in a limiter or a lag before it began.
"""


@dataclass(frozen=True, slots=True)
class Controller:
    """command = excitation − kp·y − kd·dy/dt (through a lag of 0.03 s), within limits and rate (per s)."""

    kp: float
    kd: float
    low: float
    high: float
    rate: float = float("inf")


@dataclass(frozen=True, slots=True)
class Loop:
    """A way to drive a rig: a controller on its first output, and an excitation that suits it.

    The excitation lies within ``centre`` ± ``reach``; ``tones`` (Hz) bound a multisine's frequencies and
    ``dwell`` (s) how long each of a sequence of levels lasts.
    """

    closed: bool
    controller: Controller
    centre: float
    reach: float
    tones: Range
    dwell: Range


def multisine(t: FloatArray, loop: Loop, random: np.random.Generator) -> FloatArray:
    """Two to five sines of random frequency and phase that reach as far together as one would alone."""
    count = int(random.integers(2, 6))
    low, high = np.log(loop.tones)
    frequencies = np.exp(random.uniform(low, high, count))
    phases = random.uniform(0.0, 2.0 * np.pi, count)
    waves = np.sin(2.0 * np.pi * frequencies * t[:, None] + phases).sum(axis=1)
    return np.asarray(loop.centre + loop.reach * np.sqrt(2.0 / count) * waves / 1.4)


def levels(t: FloatArray, loop: Loop, random: np.random.Generator) -> FloatArray:
    """Random levels, each held for a random while."""
    period = t[1] - t[0]
    dwell = max(1, round(float(random.uniform(*loop.dwell)) / period))
    drawn = random.uniform(-loop.reach, loop.reach, -(-len(t) // dwell))
    return np.asarray(loop.centre + np.repeat(drawn, dwell)[: len(t)])


EXCITATIONS = {"multisine": multisine, "levels": levels}


def excitation_of(sort: str, t: FloatArray, loop: Loop, random: np.random.Generator) -> FloatArray:
    """An excitation of that sort at the times ``t`` (n,), s from 0, faded in."""
    size = np.minimum(t / (FADED_IN * t[-1]), 1.0)
    return np.asarray(loop.centre + size * (EXCITATIONS[sort](t, loop, random) - loop.centre))


class Law:
    """A controller's commands, sample by sample."""

    def __init__(self, controller: Controller, period: float) -> None:
        self._of, self._period = controller, period
        self._forget = float(np.exp(-period / SLOPE_LAG))
        self._before, self._slope, self._sent = 0.0, 0.0, 0.0

    def command(self, excitation: float, seen: float) -> float:
        """The next command, from the excitation and what was measured last."""
        rising = (seen - self._before) / self._period
        self._slope = self._forget * self._slope + (1.0 - self._forget) * rising
        self._before = seen
        wanted = excitation - self._of.kp * seen - self._of.kd * self._slope
        reach = self._of.rate * self._period
        low, high = max(self._sent - reach, self._of.low), min(self._sent + reach, self._of.high)
        self._sent = min(max(wanted, low), high)
        return self._sent
