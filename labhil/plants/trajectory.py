"""What a plant's simulation gives: samples as a bench would record them, and the truth behind."""

from __future__ import annotations

import math
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


class Channel:
    """How one quantity is sampled: noise (standard deviation, AR(1) correlation) and resolution, SI.

    Coloured noise goes on from one call to the next.
    """

    def __init__(self, values: Mapping[str, float], name: str) -> None:
        self.noise = values[f"{name}_noise"]
        self.correlation = values["noise_correlation"]
        self.resolution = values.get(f"{name}_resolution", 0.0)
        self._last: float | None = None

    def sample(self, x: FloatArray, random: np.random.Generator) -> FloatArray:
        """Samples (n,) of the true values ``x`` (n,)."""
        noise = random.standard_normal(len(x))
        share = self.correlation
        if share and len(x):
            # the very first sample has no one before it, and is as large as the others
            noise[0 if self._last is not None else 1 :] *= math.sqrt(1.0 - share**2)
            noise = np.asarray(lfilter([1.0], [1.0, -share], noise, zi=[share * (self._last or 0.0)])[0])
            self._last = float(noise[-1])
        seen = x + self.noise * noise
        return np.rint(seen / self.resolution) * self.resolution if self.resolution else seen


class Sensor:
    """A sensor with lag, nonlinearity, gain error and offset; it begins settled at ``start``.

    ``period`` is the time (s) between samples; the quantity goes straight from each to the next.
    """

    def __init__(self, values: Mapping[str, float], period: float, start: float) -> None:
        self._lag = values.get("sensor_lag.time_constant", 0.0) / period
        self._cubic = values.get("sensor_nonlinearity.cubic", 0.0)
        self._gain = 1.0 + values.get("sensor_gain.gain", 0.0)
        self._offset = values.get("sensor_offset.offset", 0.0)
        self._before = self._lagged = start

    @property
    def now(self) -> float:
        """What it shows at the last value that it has followed."""
        return float(self._shown(np.array([self._lagged]))[0])

    def follow(self, x: FloatArray) -> FloatArray:
        """Go on through the next values ``x`` (n,); what it shows at each, (n,)."""
        if not len(x):
            return x
        lagged = x
        if self._lag > 0.0:
            decay = math.exp(-1.0 / self._lag)
            earlier = np.r_[self._before, x[:-1]]
            trail = (x - earlier) * self._lag
            driven = x - trail - decay * (earlier - trail)
            lagged = np.asarray(lfilter([1.0], [1.0, -decay], driven, zi=[decay * self._lagged])[0])
        self._before, self._lagged = float(x[-1]), float(lagged[-1])
        return self._shown(lagged)

    def _shown(self, x: FloatArray) -> FloatArray:
        return np.asarray(self._gain * (x + self._cubic * x**3) + self._offset)
