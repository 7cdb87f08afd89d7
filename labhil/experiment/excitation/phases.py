"""Phases that keep the peak of a sum of sines low for the power that it carries."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from math import gcd, lcm, pi

import numpy as np
from numpy.typing import NDArray

from labhil.experiment.excitation.function import Seed, crest_factor
from labhil.signals import FloatArray

STARTS = 4
"""Schroeder's phases, and that many less one drawn at random."""
ROUNDS = 150
PER_CYCLE = 12
"""Samples per cycle of the fastest tone: a peak between two of them is at most 3.5 % higher."""
MOST_SAMPLES = 8192
FINEST_HZ = 1_000_000
"""Frequencies that are whole multiples of 1 µHz have a common period."""


def schroeder_phases(amplitudes: Sequence[float]) -> tuple[float, ...]:
    """Return the phases (rad) φ_k = −2π Σ_{l<k} (k−l)·p_l, p the tones' shares of the power.

    Schroeder 1970: the instantaneous frequency then moves through the spectrum as the power does, so
    that the tones of an evenly spaced comb do not peak together.
    """
    power = np.square(np.asarray(amplitudes, dtype=np.float64))
    total = float(power.sum())
    if total == 0.0:
        return (0.0,) * len(power)
    phases = -2 * pi * np.concatenate(([0.0], np.cumsum(np.cumsum(power / total))[:-1]))
    return tuple(float(phase) for phase in phases)


def low_crest_phases(
    frequencies: Sequence[float], amplitudes: Sequence[float], duration: float, seed: Seed = 0
) -> tuple[float, ...]:
    """Return phases (rad) with a lower crest factor within ``duration`` s than Schroeder's, if any are found.

    Clip and restore (van der Ouderaa, Schoukens and Renneboog 1988): clip the sum of sines, take the
    phases of what is left, give the tones their amplitudes back, and again, with an ever higher clip;
    from Schroeder's phases and some drawn with ``seed``. The same arguments give the same phases.
    """
    return _search_phases(tuple(frequencies), tuple(amplitudes), duration, seed)


@lru_cache(maxsize=64)
def _search_phases(
    frequencies: tuple[float, ...], amplitudes: tuple[float, ...], duration: float, seed: Seed
) -> tuple[float, ...]:
    schroeder = schroeder_phases(amplitudes)
    if len(frequencies) < 2 or not any(amplitudes):
        return schroeder
    waves = _waves(frequencies, min(duration, common_period(frequencies)))
    heights = np.asarray(amplitudes, dtype=np.float64)
    draw = np.random.default_rng(seed)
    starts = [np.asarray(schroeder)]
    starts += [draw.uniform(-pi, pi, len(heights)) for _ in range(STARTS - 1)]
    best = crest_factor(_sum(waves, heights, starts[0])), starts[0]
    for start in starts:
        candidate = _clip_peaks(waves, heights, start)
        if candidate[0] < best[0] * (1 - 1e-9):
            best = candidate
    return tuple(float(phase) for phase in best[1])


def common_period(frequencies: Sequence[float]) -> float:
    """Return the time (s) after which all tones (Hz) are where they began."""
    rational = [Fraction(frequency).limit_denominator(FINEST_HZ) for frequency in frequencies]
    below = lcm(*(fraction.denominator for fraction in rational))
    above = gcd(*(int(fraction * below) for fraction in rational))
    return below / above if above else 1.0 / min(frequencies)


def _waves(frequencies: tuple[float, ...], duration: float) -> NDArray[np.complex128]:
    """exp(2πi·f·t) on a grid over ``duration``, or over as much of it as the most samples reach."""
    count = int(min(max(duration * max(frequencies) * PER_CYCLE, 64), MOST_SAMPLES))
    step = min(duration / count, 1 / (PER_CYCLE * max(frequencies)))
    turns = np.outer(np.arange(count) * step, frequencies)
    return np.exp(2j * pi * turns)


def _sum(waves: NDArray[np.complex128], heights: FloatArray, phases: FloatArray) -> FloatArray:
    return np.asarray((waves @ (heights * np.exp(1j * phases))).imag)


def _clip_peaks(
    waves: NDArray[np.complex128], heights: FloatArray, phases: FloatArray
) -> tuple[float, FloatArray]:
    adjoint = waves.conj().T
    best = np.inf, phases
    for i in range(ROUNDS):
        values = _sum(waves, heights, phases)
        crest = crest_factor(values)
        if crest < best[0]:
            best = crest, phases
        # from a third of the way up to nearly all of it: first the rough shape, then the last peaks
        clip = (0.75 + 0.24 * i / ROUNDS) * float(np.max(np.abs(values)))
        coefficients = adjoint @ np.clip(values, -clip, clip)
        phases = np.asarray(np.angle(1j * coefficients), dtype=np.float64)
    return best
