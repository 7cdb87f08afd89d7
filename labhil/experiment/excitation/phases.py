"""Phases of a multisine that keep its crest factor low: in closed form, and by iteration."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from math import gcd, lcm, pi

import numpy as np
from numpy.typing import NDArray

from labhil.experiment.excitation.function import Seed, crest_factor
from labhil.signals import FloatArray


def schroeder_phases(amplitudes: Sequence[float]) -> tuple[float, ...]:
    """Return Schroeder's phases (rad) φ_k = −2π Σ_{l<k} (k−l)·p_l, p the tones' shares of the power.

    The instantaneous frequency then moves through the spectrum in proportion to the power, so that the tones
    of an evenly spaced comb do not peak together (Schroeder 1970).
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
    """Search phases with a lower crest factor than Schroeder's, by clipping (clip and restore).

    Clip the sum of sines, take the phases of the clipped signal, restore the amplitudes, and repeat with a
    rising clip level (van der Ouderaa, Schoukens and Renneboog 1988). The search starts from Schroeder's
    phases and from random ones. Equal arguments give equal phases.

    Args:
        frequencies: Frequencies of the tones, Hz.
        amplitudes: Amplitudes of the tones, in any unit.
        duration: Duration over which the crest factor counts, s.
        seed: Seed of the random start phases.

    Returns:
        Phases, rad; Schroeder's where the search finds none better.
    """
    return _search_phases(tuple(frequencies), tuple(amplitudes), duration, seed)


@lru_cache(maxsize=64)
def _search_phases(
    frequencies: tuple[float, ...],
    amplitudes: tuple[float, ...],
    duration: float,
    seed: Seed,
    *,
    n_starts: int = 4,
) -> tuple[float, ...]:
    """Search from ``n_starts`` phases: Schroeder's, the others random."""
    schroeder = schroeder_phases(amplitudes)
    if len(frequencies) < 2 or not any(amplitudes):
        return schroeder
    phasors = _phasors(frequencies, min(duration, common_period(frequencies)))
    weights = np.asarray(amplitudes, dtype=np.float64)
    rng = np.random.default_rng(seed)
    starts = [np.asarray(schroeder)]
    starts += [rng.uniform(-pi, pi, len(weights)) for _ in range(n_starts - 1)]
    best = crest_factor(_sum_tones(phasors, weights, starts[0])), starts[0]
    for start in starts:
        candidate = _clip_peaks(phasors, weights, start)
        if candidate[0] < best[0] * (1 - 1e-9):
            best = candidate
    return tuple(float(phase) for phase in best[1])


def common_period(frequencies: Sequence[float], *, max_denominator: int = 1_000_000) -> float:
    """Return the common period of tones, s.

    Args:
        frequencies: Frequencies, Hz.
        max_denominator: Frequencies are rounded to fractions with this denominator at most; the default
            resolves whole multiples of 1 µHz.
    """
    rational = [Fraction(frequency).limit_denominator(max_denominator) for frequency in frequencies]
    denominator = lcm(*(fraction.denominator for fraction in rational))
    numerator = gcd(*(int(fraction * denominator) for fraction in rational))
    return denominator / numerator if numerator else 1.0 / min(frequencies)


def _phasors(
    frequencies: tuple[float, ...], duration: float, *, samples_per_cycle: int = 12, max_samples: int = 8192
) -> NDArray[np.complex128]:
    """Return exp(2πi·f·t), (samples, tones), on a grid over the duration, or as far as the samples reach.

    With 12 samples per cycle of the fastest tone a peak between two of them is at most 3.5 % higher.
    """
    count = int(min(max(duration * max(frequencies) * samples_per_cycle, 64), max_samples))
    step = min(duration / count, 1 / (samples_per_cycle * max(frequencies)))
    cycles = np.outer(np.arange(count) * step, frequencies)
    return np.exp(2j * pi * cycles)


def _sum_tones(phasors: NDArray[np.complex128], amplitudes: FloatArray, phases: FloatArray) -> FloatArray:
    return np.asarray((phasors @ (amplitudes * np.exp(1j * phases))).imag)


def _clip_peaks(
    phasors: NDArray[np.complex128], amplitudes: FloatArray, phases: FloatArray, *, n_iterations: int = 150
) -> tuple[float, FloatArray]:
    """Return the lowest crest factor of the clip-and-restore iterations, and its phases."""
    adjoint = phasors.conj().T
    best = np.inf, phases
    for i in range(n_iterations):
        values = _sum_tones(phasors, amplitudes, phases)
        crest = crest_factor(values)
        if crest < best[0]:
            best = crest, phases
        # a low clip level forms the rough shape, a high one removes the last peaks
        clip = (0.75 + 0.24 * i / n_iterations) * float(np.max(np.abs(values)))
        coefficients = adjoint @ np.clip(values, -clip, clip)
        phases = np.asarray(np.angle(1j * coefficients), dtype=np.float64)
    return best
