"""Measurement noise of simulated recordings."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from labhil.signals import FloatArray

COLOUR = 0.7


def noise_like(n: int, sigma: float, coloured: bool, random: np.random.Generator) -> FloatArray:
    """White noise (n,) of this standard deviation, or coloured: AR(1), neighbours correlated by 0.7."""
    white = random.standard_normal(n)
    if not coloured:
        return np.asarray(sigma * white)
    return np.asarray(sigma * lfilter([np.sqrt(1.0 - COLOUR**2)], [1.0, -COLOUR], white))
