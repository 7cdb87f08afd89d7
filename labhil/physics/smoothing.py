"""Smoothing of white noise by local cubics with a width that adapts to the signal.

A local cubic (Savitzky and Golay 1964) over many samples removes most of the noise but smears jumps. Each
sample therefore takes the widest one whose value agrees, within the noise, with those of all narrower ones
(Lepski 1990; Goldenshluger and Nemirovski 1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_coeffs, savgol_filter

from labhil.signals import FloatArray, IntArray

DEGREE = 3
"""Degree of the local polynomials."""

WIDTHS = (1, 5, 7, 9, 11, 15, 21, 31, 41, 61, 81)
"""Samples of a local cubic; 1 is the sample itself."""

AGREEMENT = 2.5
"""Largest difference of two values that agree, in standard errors of their difference."""

MEDIAN_WIDTH = 5
"""Samples of the median filter over widths: an isolated disagreement is noise."""


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Smoother of a channel with white noise of standard deviation ``noise``; 0 for none."""

    noise: float

    def of(self, values: FloatArray) -> FloatArray:
        """Smooth values (n,)."""
        if not self.noise:
            return values
        cubics = _cubics(values)
        return np.take_along_axis(cubics, self._widest(cubics)[None], axis=0)[0]

    def remaining_noise(self, values: FloatArray) -> float:
        """Standard deviation of the noise that remains after smoothing values (n,)."""
        if not self.noise:
            return 0.0
        return self.noise * float(np.sqrt(np.mean(VARIANCE_FACTORS[self._widest(_cubics(values))])))

    def error(self, smoothed: FloatArray, random: np.random.Generator) -> FloatArray:
        """Draw a random error of smoothed values (n,): smooth them with new noise and subtract them."""
        return self.of(smoothed + random.normal(0.0, self.noise, len(smoothed))) - smoothed

    def _widest(self, cubics: FloatArray) -> IntArray:
        """Index (n,) of the widest of the cubics (W, n) that agrees with all narrower ones."""
        widest = np.zeros(cubics.shape[1], dtype=np.int64)
        for wide in range(1, len(cubics)):
            # both are fitted to the same samples, so the variance of their difference is the difference
            errors = self.noise * np.sqrt(VARIANCE_FACTORS[:wide] - VARIANCE_FACTORS[wide])[:, None]
            agree = np.all(np.abs(cubics[:wide] - cubics[wide]) <= AGREEMENT * errors, axis=0)
            widest[agree & (widest == wide - 1)] = wide
        # noise makes single samples disagree; at a jump the neighbours disagree too
        return np.asarray(median_filter(widest, MEDIAN_WIDTH))


def _cubics(values: FloatArray) -> FloatArray:
    """Values (n,) smoothed by cubics of each width that is not longer than the signal, (W, n)."""
    wider = [savgol_filter(values, width, DEGREE) for width in WIDTHS[1:] if width <= len(values)]
    return np.array([values, *wider])


VARIANCE_FACTORS = np.array([1.0, *(savgol_coeffs(width, DEGREE)[width // 2] for width in WIDTHS[1:])])
"""Variance of a smoothed value over that of the noise, for each width."""
