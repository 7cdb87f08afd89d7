"""What a plant's simulation gives: samples as a bench would record them, and the truth behind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Samples at ``t`` (n,) s with the command ``input`` (n,) in effect there.

    ``measured`` holds the contract's signals by name, ``truth`` the undisturbed states; each (n,), SI.
    """

    t: FloatArray
    input: FloatArray
    measured: Mapping[str, FloatArray]
    truth: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True)
class Channel:
    """How one quantity is sampled: noise (standard deviation, AR(1) correlation) and resolution, SI."""

    noise: float
    correlation: float
    resolution: float

    @classmethod
    def of(cls, values: Mapping[str, float], name: str) -> Channel:
        """Pick the channel ``name`` out of a plant's parameters."""
        return cls(
            values[f"{name}_noise"], values["noise_correlation"], values.get(f"{name}_resolution", 0.0)
        )

    def sample(self, x: FloatArray, random: np.random.Generator) -> FloatArray:
        """Samples (n,) of the true values ``x`` (n,)."""
        white = random.standard_normal(len(x))
        share = self.correlation
        if share:
            # the first sample is as large as the others
            white[1:] *= np.sqrt(1.0 - share**2)
            white = np.asarray(lfilter([1.0], [1.0, -share], white))
        seen = x + self.noise * white
        return np.rint(seen / self.resolution) * self.resolution if self.resolution else seen


def lagged(x: FloatArray, h: float, time_constant: float) -> FloatArray:
    """A sensor's first-order lag over samples ``h`` s apart, straight in between; begins settled."""
    if time_constant <= 0.0:
        return x
    decay = np.exp(-h / time_constant)
    trail = np.r_[0.0, np.diff(x)] / h * time_constant
    driven = x - trail - decay * (np.r_[x[0], x[:-1]] - trail)
    driven[0] = x[0]
    return np.asarray(lfilter([1.0], [1.0, -decay], driven))


def sensed(x: FloatArray, values: Mapping[str, float], h: float) -> FloatArray:
    """What a sensor with lag, nonlinearity, gain error and offset makes of ``x`` (n,)."""
    x = lagged(x, h, values.get("sensor_lag.time_constant", 0.0))
    x = x + values.get("sensor_nonlinearity.cubic", 0.0) * x**3
    return (1.0 + values.get("sensor_gain.gain", 0.0)) * x + values.get("sensor_offset.offset", 0.0)
