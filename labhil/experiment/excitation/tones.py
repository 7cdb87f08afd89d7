"""Sinusoidal excitations: two sines, a multisine, and a chirp."""

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
    """A multisine: Σ ``amplitudes``·sin(2π·``frequencies``·t + ``phases``) + ``offset``; Hz and rad."""

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
    """A sine whose frequency sweeps from ``start`` to ``stop`` Hz in ``duration`` s, and on at that pace.

    A "linear" ``sweep`` passes every Hz in the same time, a "logarithmic" one every octave. With
    ``there_and_back`` it arrives after half of ``duration`` and returns in the other half.
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
        return self.offset + self.amplitude * sin(2 * pi * self._cycles(t) + self.phase)

    def _cycles(self, t: float) -> float:
        """Return the phase at time ``t`` s, in cycles."""
        if not self.there_and_back:
            return self._sweep_cycles(t, self.duration)
        half = self.duration / 2
        if t <= half:
            return self._sweep_cycles(t, half)
        return 2 * self._sweep_cycles(half, half) - self._sweep_cycles(2 * half - t, half)

    def _sweep_cycles(self, t: float, duration: float) -> float:
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
    """Return the sum of two sines, both starting at zero unless ``phases`` (rad) are given."""
    if len(frequencies) != 2:
        raise ValueError(f"`frequencies` has {len(frequencies)} values; two_sine takes two")
    return _make_tones(frequencies, amplitude, _explicit_phases("two_sine", phases) or (0.0, 0.0), offset)


def multisine(
    frequencies: Sequence[float],
    amplitude: float | Sequence[float],
    phases: PhaseRule | Sequence[float] = "low_crest",
    offset: float = 0.0,
    duration: float = inf,
    seed: Seed = 0,
) -> Tones:
    """Return a multisine: a sum of sines.

    Args:
        frequencies: Frequencies of the tones, Hz.
        amplitude: Amplitude of all tones, or one each.
        phases: Phases, rad, one each, or a rule: "schroeder" (closed form), "low_crest" (improved from there
            for a low crest factor within ``duration``), or "random".
        offset: Constant that is added.
        duration: Duration of the step, s.
        seed: Seed of random phases.
    """
    _check_frequencies(frequencies)
    amplitudes = _one_per_tone(amplitude, len(frequencies), "amplitude")
    if phases == "low_crest":
        phases = low_crest_phases(frequencies, amplitudes, duration, seed)
    elif phases == "schroeder":
        phases = schroeder_phases(amplitudes)
    elif phases == "random":
        random_phases = np.random.default_rng(seed).uniform(-pi, pi, len(frequencies))
        phases = tuple(float(phase) for phase in random_phases)
    elif isinstance(phases, str):
        raise ValueError(
            f"`phases` must be numbers (rad), 'low_crest', 'schroeder' or 'random', found {phases!r}"
        )
    return _make_tones(frequencies, amplitudes, phases, offset)


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
    (phase,) = _one_per_tone(_explicit_phases("chirp", phases) or 0.0, 1, "phases")
    (scalar_amplitude,) = _one_per_tone(amplitude, 1, "amplitude")
    start, stop = frequencies
    return Chirp(start, stop, scalar_amplitude, duration, phase, offset, sweep, there_and_back)


def _explicit_phases(name: str, phases: PhaseRule | Sequence[float] | None) -> Sequence[float]:
    """Return phases that are numbers, none when absent; a rule only makes sense for many tones."""
    if phases is None:
        return ()
    if not isinstance(phases, str):
        return phases
    raise ValueError(f"`phases` of {name} must be numbers (rad), found {phases!r}")


def _make_tones(
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
