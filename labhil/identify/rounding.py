"""What a converter's rounding leaves in readings whose noise is too small to dither it.

Of a value x under Gaussian noise of standard deviation σ, readings in steps of q have the mean error

    e(x) = (q/π)·Σₖ (−1)ᵏ/k·sin(2πkx/q)·exp(−2(πkσ/q)²),   k = 1, 2, …

(Widrow and Kollár 2008, Quantization Noise, ch. 19); only what is left of their error is independent from one
sample to the next. While a motion takes many samples to pass a step, e(x) stays, and a mean over these
samples keeps it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from labhil.compiled import compiled
from labhil.identify.quantiser import converter_step
from labhil.physics.model import Record
from labhil.signals import FloatArray, IntArray

PLACES = 256
"""Within a step, at which the error is tabulated."""

SMOOTHED = 9
"""Readings whose mean shows where a channel is, between flips of its last digit by noise."""

LEAST = 1e-3
"""Share of the noise's variance below which rounding is as good as independent noise."""


@dataclass(frozen=True, slots=True)
class Rounding:
    """A channel's ``step`` in its unit, the lasting ``error`` (PLACES + 1,) along a step, in steps.

    ``share`` is what of the noise's variance that error is on the average.
    """

    step: float
    error: FloatArray
    share: float

    @classmethod
    def of(cls, readings: FloatArray, sigma: float) -> Rounding | None:
        """That of readings (n,) with noise ``sigma``, rounding and all; None where none lasts."""
        step = converter_step(readings)
        if step == 0.0:
            return None
        dither = max((sigma / step) ** 2 - 1.0 / 12.0, 0.0)
        error = _smoothed_saw(dither)
        share = float(np.mean(error[:-1] ** 2)) * (step / sigma) ** 2
        return cls(step, error, share) if share > LEAST else None

    def lasting(self, values: FloatArray, phase: float) -> FloatArray:
        """The error (N,) of ``values`` (N,), in their unit, the converter's steps shifted by a ``phase``."""
        places = np.mod(values / self.step + phase, 1.0) * PLACES
        return np.asarray(self.step * np.interp(places, np.arange(PLACES + 1.0), self.error))


def effective_fractions(record: Record, sigma: FloatArray) -> FloatArray:
    """What share of an independent sample each of all readings is worth, (n, c), with noise ``sigma`` (c,).

    Of n readings of one place the error that lasts, a share s of the noise's variance, is the same: they are
    worth 1/(s + (1 − s)/n) independent ones.
    """
    shares = np.ones(record.outputs.shape)
    for c, (readings, noise) in enumerate(zip(record.outputs.T, sigma, strict=True)):
        rounded = Rounding.of(readings, noise)
        if rounded is not None:
            stay = _stays(uniform_filter1d(readings, SMOOTHED), rounded.step)
            shares[:, c] = 1.0 / (1.0 + rounded.share * (np.bincount(stay)[stay] - 1.0))
    return shares


@compiled
def _stays(values: FloatArray, width: float) -> IntArray:
    """Number (n,) of the stay that each value is of; it ends where one is further away than the width."""
    stays = np.zeros(len(values), dtype=np.int64)
    begin = values[0]
    for i in range(1, len(values)):
        stays[i] = stays[i - 1]
        if abs(values[i] - begin) > width:
            begin = values[i]
            stays[i] += 1
    return stays


def _smoothed_saw(dither: float) -> FloatArray:
    """The series along one step, in steps, for noise of a variance ``dither`` in steps², (PLACES + 1,)."""
    along = np.arange(PLACES) / PLACES
    # at half a step a reading falls to either side
    saw = np.where(along < 0.5, -along, 1.0 - along)
    saw[PLACES // 2] = 0.0
    waves = np.arange(PLACES // 2 + 1)
    smoothed = np.fft.irfft(np.fft.rfft(saw) * np.exp(-2.0 * np.pi**2 * waves**2 * dither), PLACES)
    return np.append(smoothed, smoothed[0])
