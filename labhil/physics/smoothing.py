"""White noise is taken off a channel by local cubics, each over as many samples as the channel there allows.

A local cubic (Savitzky and Golay 1964) over many samples takes off most of the noise, and smears what jumps.
Each sample therefore has the widest one whose value agrees with those of all narrower ones, as far as the
noise lets them differ (Lepski 1990; Goldenshluger and Nemirovski 1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_coeffs, savgol_filter

from labhil.signals import FloatArray, IntArray

DEGREE = 3

WIDTHS = (1, 5, 7, 9, 11, 15, 21, 31, 41, 61, 81)
"""Samples that a cubic is fitted to; of one it is the sample itself."""

AGREE = 2.5
"""Standard errors of their difference within which two values of a sample agree."""

NEIGHBOURS = 5
"""Samples of which most have to disagree."""


@dataclass(frozen=True, slots=True)
class Smoothing:
    """White ``noise`` of a channel, in its unit, to be taken off; none where it is 0."""

    noise: float

    def of(self, values: FloatArray) -> FloatArray:
        """Values (n,) without most of their noise."""
        if not self.noise:
            return values
        cubics = _cubics(values)
        return np.take_along_axis(cubics, self._widest(cubics)[None], axis=0)[0]

    def remaining_noise(self, values: FloatArray) -> float:
        """Standard deviation of the noise that is left on values (n,), RMS."""
        if not self.noise:
            return 0.0
        return self.noise * float(np.sqrt(np.mean(SHARES[self._widest(_cubics(values))])))

    def error(self, smoothed: FloatArray, random: np.random.Generator) -> FloatArray:
        """What noise leaves in values (n,) that were smoothed, drawn at random anew."""
        return self.of(smoothed + random.normal(0.0, self.noise, len(smoothed))) - smoothed

    def _widest(self, cubics: FloatArray) -> IntArray:
        """Which of the widths (n,) is the widest whose cubic agrees with all narrower ones (W, n)."""
        widest = np.zeros(cubics.shape[1], dtype=np.int64)
        for wide in range(1, len(cubics)):
            # of a narrower one's error the wider one, fitted to the same samples, has a part in common
            errors = self.noise * np.sqrt(SHARES[:wide] - SHARES[wide])[:, None]
            agree = np.all(np.abs(cubics[:wide] - cubics[wide]) <= AGREE * errors, axis=0)
            widest[agree & (widest == wide - 1)] = wide
        # noise by itself lets some sample disagree now and then; what jumps does so with its neighbours
        return np.asarray(median_filter(widest, NEIGHBOURS))


def _cubics(values: FloatArray) -> FloatArray:
    """The values (n,) by cubics over each of the widths, (W, n); over none that is longer than they are."""
    wider = [savgol_filter(values, width, DEGREE) for width in WIDTHS[1:] if width <= len(values)]
    return np.array([values, *wider])


SHARES = np.array([1.0, *(savgol_coeffs(width, DEGREE)[width // 2] for width in WIDTHS[1:])])
"""Variance of a smoothed value over that of the noise, of each width."""
