"""Sines: two of them, many at once, and one that sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite, log, pi, sin
from typing import Literal

import numpy as np

from labhil.experiment.excitation.function import Seed
from labhil.experiment.excitation.phases import low_crest_phases, schroeder_phases

PhaseRule = Literal["low_crest", "schroeder", "random"]
Sweep = Literal["linear", "logarithmic"]


@dataclass(frozen=True, slots=True)
class Tones:
    """A sum of sines: Σ ``amplitudes``·sin(2π·``frequencies``·t + ``phases``) + ``offset``; Hz and rad."""

    frequencies: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]
    offset: float = 0.0

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        total = self.offset
        for frequency, amplitude, phase in zip(self.frequencies, self.amplitudes, self.phases, strict=True):
            total += amplitude * sin(2 * pi * frequency * t + phase)
        return total


@dataclass(frozen=True, slots=True)
class Chirp:
    """A sine whose frequency goes from ``start`` to ``stop`` Hz in ``duration`` s, then on as it was going.

    ``sweep`` "linear" passes every Hz, "logarithmic" every octave, in the same time. With
    ``there_and_back`` it arrives after half of ``duration`` and goes back the way it came.
    """

    start: float
    stop: float
    amplitude: float
    duration: float
    phase: float = 0.0
    offset: float = 0.0
    sweep: Sweep = "linear"
    there_and_back: bool = False

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        return self.offset + self.amplitude * sin(2 * pi * self._turns(t) + self.phase)

    def _turns(self, t: float) -> float:
        if not self.there_and_back:
            return self._one_way(t, self.duration)
        half = self.duration / 2
        if t <= half:
            return self._one_way(t, half)
        return 2 * self._one_way(half, half) - self._one_way(2 * half - t, half)

    def _one_way(self, t: float, duration: float) -> float:
        ratio = self.stop / self.start
        if self.sweep == "linear" or ratio == 1.0:
            return self.start * t + (self.stop - self.start) * t * t / (2 * duration)
        return self.start * duration / log(ratio) * (ratio ** (t / duration) - 1.0)


def two_sine(
    frequencies: Sequence[float],
    amplitude: float | Sequence[float],
    phases: Sequence[float] | None = None,
    offset: float = 0.0,
) -> Tones:
    """Return the sum of two sines, both starting at zero unless ``phases`` (rad) says otherwise."""
    if len(frequencies) != 2:
        raise ValueError(f"`frequencies` has {len(frequencies)} values; two_sine takes two")
    return _tones(frequencies, amplitude, _numbers("two_sine", phases) or (0.0, 0.0), offset)


def multisine(
    frequencies: Sequence[float],
    amplitude: float | Sequence[float],
    phases: PhaseRule | Sequence[float] = "low_crest",
    offset: float = 0.0,
    duration: float = inf,
    seed: Seed = 0,
) -> Tones:
    """Return a sum of sines (Hz).

    ``phases`` are rad, one each, or a rule: "schroeder" in closed form, "low_crest" improved from
    there so that the peak within ``duration`` s is low for the power, "random" drawn.
    """
    _check_frequencies(frequencies)
    amplitudes = _one_per_tone(amplitude, len(frequencies), "amplitude")
    if phases == "low_crest":
        phases = low_crest_phases(frequencies, amplitudes, duration, seed)
    elif phases == "schroeder":
        phases = schroeder_phases(amplitudes)
    elif phases == "random":
        drawn = np.random.default_rng(seed).uniform(-pi, pi, len(frequencies))
        phases = tuple(float(phase) for phase in drawn)
    elif isinstance(phases, str):
        raise ValueError(
            f"`phases` must be numbers (rad), 'low_crest', 'schroeder' or 'random', found {phases!r}"
        )
    return _tones(frequencies, amplitudes, phases, offset)


def chirp(
    frequencies: Sequence[float],
    amplitude: float | Sequence[float],
    duration: float,
    phases: Sequence[float] | None = None,
    offset: float = 0.0,
    sweep: Sweep = "linear",
    there_and_back: bool = False,
) -> Chirp:
    """Return a sine that sweeps between two ``frequencies`` (Hz) in ``duration`` s."""
    if len(frequencies) != 2:
        raise ValueError(f"`frequencies` has {len(frequencies)} values; chirp takes two: from, to")
    _check_frequencies(frequencies)
    if not 0 < duration < inf:
        raise ValueError(f"`duration` must be positive, found {duration:g}")
    if sweep not in ("linear", "logarithmic"):
        raise ValueError(f"`sweep` must be 'linear' or 'logarithmic', found {sweep!r}")
    (phase,) = _one_per_tone(_numbers("chirp", phases) or 0.0, 1, "phases")
    (height,) = _one_per_tone(amplitude, 1, "amplitude")
    first, last = frequencies
    return Chirp(first, last, height, duration, phase, offset, sweep, there_and_back)


def _numbers(name: str, phases: PhaseRule | Sequence[float] | None) -> Sequence[float]:
    """Phases as numbers, none when absent: a rule is for many tones."""
    if phases is None:
        return ()
    if not isinstance(phases, str):
        return phases
    raise ValueError(f"`phases` of {name} must be numbers (rad), found {phases!r}")


def _tones(
    frequencies: Sequence[float], amplitude: float | Sequence[float], phases: Sequence[float], offset: float
) -> Tones:
    _check_frequencies(frequencies)
    count = len(frequencies)
    amplitudes = _one_per_tone(amplitude, count, "amplitude")
    return Tones(tuple(frequencies), amplitudes, _one_per_tone(phases, count, "phases"), offset)


def _check_frequencies(frequencies: Sequence[float]) -> None:
    if not frequencies:
        raise ValueError("`frequencies` is empty; give at least one, in Hz")
    for frequency in frequencies:
        if not (isfinite(frequency) and frequency > 0):
            raise ValueError(f"`frequencies` must be positive numbers of Hz, found {frequency:g}")


def _one_per_tone(value: float | Sequence[float], count: int, name: str) -> tuple[float, ...]:
    if isinstance(value, (int, float)):
        return (float(value),) * count
    if len(value) != count:
        raise ValueError(f"`{name}` has {len(value)} values for {count} tones; give one, or one each")
    return tuple(float(item) for item in value)
