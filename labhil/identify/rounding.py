"""Quantisation errors of readings whose noise is too small to dither the converter.

For a value x with Gaussian noise of standard deviation σ, readings in steps of q have the mean error

    e(x) = (q/π)·Σₖ (−1)ᵏ/k·sin(2πkx/q)·exp(−2(πkσ/q)²),   k = 1, 2, …

(Widrow and Kollár 2008, Quantization Noise, ch. 19). Only the remainder of their error is independent from
one sample to the next. While a motion takes many samples to pass a step, e(x) stays the same, and a mean over
these samples does not reduce it. ``quantiser`` finds the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from labhil.compiled import compiled
from labhil.identify.quantiser import converter_step
from labhil.physics.record import Record
from labhil.signals import FloatArray, IntArray

TABLE_SIZE = 256
"""Points within a step at which the mean error is tabulated."""


@dataclass(frozen=True, slots=True)
class Rounding:
    """The mean quantisation error of a channel.

    Attributes:
        step: Quantisation step in the channel's unit.
        error: (TABLE_SIZE + 1,) mean error along one step, in steps.
        share: Mean square of that error over the variance of the noise.
    """

    step: float
    error: FloatArray
    share: float

    @classmethod
    def of(cls, readings: FloatArray, sigma: float, *, min_share: float = 1e-3) -> Rounding | None:
        """Estimate the mean quantisation error of a channel from its readings.

        Args:
            readings: (n,) of the channel.
            sigma: Standard deviation of its noise, quantisation included, in its unit.
            min_share: Share of the noise's variance below which quantisation counts as independent noise.

        Returns:
            None where all of the error counts as independent noise.
        """
        step = converter_step(readings)
        if step == 0.0:
            return None
        dither = max((sigma / step) ** 2 - 1.0 / 12.0, 0.0)
        error = _dithered_error(dither)
        share = float(np.mean(error[:-1] ** 2)) * (step / sigma) ** 2
        return cls(step, error, share) if share > min_share else None

    def mean_error(self, values: FloatArray, phase: float) -> FloatArray:
        """Mean quantisation error (N,) of ``values`` (N,), in their unit.

        ``phase`` shifts the converter's steps, as a fraction of a step.
        """
        places = np.mod(values / self.step + phase, 1.0) * TABLE_SIZE
        return np.asarray(self.step * np.interp(places, np.arange(TABLE_SIZE + 1.0), self.error))


def effective_fractions(record: Record, sigma: FloatArray, *, smoothing_samples: int = 9) -> FloatArray:
    """Share of an independent sample that each reading is worth under quantisation.

    Of n readings within one step the mean error, a share s of the noise's variance, is the same: they are
    worth 1/(s + (1 − s)/n) independent ones.

    Args:
        record: With n samples of c channels.
        sigma: (c,) standard deviation of each channel's noise, in its unit.
        smoothing_samples: Readings whose mean says in which step a channel is, as noise toggles its last
            digit.

    Returns:
        (n, c), each in 0 … 1.
    """
    shares = np.ones(record.outputs.shape)
    for c, (readings, noise) in enumerate(zip(record.outputs.T, sigma, strict=True)):
        rounding = Rounding.of(readings, noise)
        if rounding is not None:
            group = _group_by_step(uniform_filter1d(readings, smoothing_samples), rounding.step)
            shares[:, c] = 1.0 / (1.0 + rounding.share * (np.bincount(group)[group] - 1.0))
    return shares


@compiled
def _group_by_step(values: FloatArray, width: float) -> IntArray:
    """Number groups (n,) of values; one further than the width from its group's first begins the next."""
    groups = np.zeros(len(values), dtype=np.int64)
    first = values[0]
    for i in range(1, len(values)):
        groups[i] = groups[i - 1]
        if abs(values[i] - first) > width:
            first = values[i]
            groups[i] += 1
    return groups


def _dithered_error(dither: float) -> FloatArray:
    """Mean error (TABLE_SIZE + 1,) along a step, in steps, for noise of variance ``dither`` in steps²."""
    along = np.arange(TABLE_SIZE) / TABLE_SIZE
    # at half a step a reading falls to either side
    sawtooth = np.where(along < 0.5, -along, 1.0 - along)
    sawtooth[TABLE_SIZE // 2] = 0.0
    order = np.arange(TABLE_SIZE // 2 + 1)
    attenuation = np.exp(-2.0 * np.pi**2 * order**2 * dither)
    smoothed = np.fft.irfft(np.fft.rfft(sawtooth) * attenuation, TABLE_SIZE)
    return np.append(smoothed, smoothed[0])
