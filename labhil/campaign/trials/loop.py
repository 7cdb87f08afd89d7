"""The drive of a rig with one input: a controller on its first output, and an excitation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.signals import FloatArray

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Controller:
    """command = excitation − kp·y − kd·dy/dt (with a first-order lag), within limits and rate (per s)."""

    kp: float
    kd: float
    low: float
    high: float
    rate: float = float("inf")


@dataclass(frozen=True, slots=True)
class Loop:
    """A controller on a rig's first output, and the ranges of its excitation.

    The excitation is within ``centre`` ± ``reach``; ``tones`` is the range of a multisine's frequencies, Hz,
    ``dwell`` that of the time for which each of a sequence of levels is held, s.
    """

    closed: bool
    controller: Controller
    centre: float
    reach: float
    tones: Range
    dwell: Range


def multisine(t: FloatArray, loop: Loop, rng: np.random.Generator) -> FloatArray:
    """Return two to five sines of random frequency and phase, with the power of a single one."""
    count = int(rng.integers(2, 6))
    low, high = np.log(loop.tones)
    frequencies = np.exp(rng.uniform(low, high, count))
    phases = rng.uniform(0.0, 2.0 * np.pi, count)
    waves = np.sin(2.0 * np.pi * frequencies * t[:, None] + phases).sum(axis=1)
    return np.asarray(loop.centre + loop.reach * np.sqrt(2.0 / count) * waves / 1.4)


def levels(t: FloatArray, loop: Loop, rng: np.random.Generator) -> FloatArray:
    """Return random levels, each held for the same random time."""
    period = t[1] - t[0]
    dwell = max(1, round(float(rng.uniform(*loop.dwell)) / period))
    drawn = rng.uniform(-loop.reach, loop.reach, -(-len(t) // dwell))
    return np.asarray(loop.centre + np.repeat(drawn, dwell)[: len(t)])


EXCITATIONS = {"multisine": multisine, "levels": levels}


def make_excitation(
    kind: str, t: FloatArray, loop: Loop, rng: np.random.Generator, fade_in: float = 0.02
) -> FloatArray:
    """Make an excitation that is faded in.

    Args:
        kind: a key of ``EXCITATIONS``.
        t: times (n,), s from 0.
        loop: the ranges of the excitation.
        rng: the source of randomness.
        fade_in: share of the time in which the excitation grows from its centre to its full size. A recording
            does not contain the state of a limiter or a lag at its beginning.
    """
    size = np.minimum(t / (fade_in * t[-1]), 1.0)
    return np.asarray(loop.centre + size * (EXCITATIONS[kind](t, loop, rng) - loop.centre))


class ControllerState:
    """A controller that runs with a sample period (s); ``lag`` (s) is the time constant of its derivative."""

    def __init__(self, controller: Controller, period: float, lag: float = 0.03) -> None:
        self._controller, self._period = controller, period
        self._decay = float(np.exp(-period / lag))
        self._last_measured, self._slope, self._sent = 0.0, 0.0, 0.0

    def command(self, excitation: float, measured: float) -> float:
        """Return the next command, from the excitation and the last measurement."""
        rate = (measured - self._last_measured) / self._period
        self._slope = self._decay * self._slope + (1.0 - self._decay) * rate
        self._last_measured = measured
        command = excitation - self._controller.kp * measured - self._controller.kd * self._slope
        max_change = self._controller.rate * self._period
        low, high = (
            max(self._sent - max_change, self._controller.low),
            min(self._sent + max_change, self._controller.high),
        )
        self._sent = min(max(command, low), high)
        return self._sent
