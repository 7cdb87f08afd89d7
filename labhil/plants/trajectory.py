"""What a plant's simulation gives: samples as a bench would record them, and the truth behind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from labhil.errors import UsageError
from labhil.signals import FloatArray

LARGEST_JITTER = 0.4
"""Share of a period by which a sample is early or late at most."""

AT_ONCE = 256
"""Random numbers that are drawn together."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Samples at ``t`` (n,) s with the recorded ``input`` (n,) in effect there.

    ``measured`` holds the contract's signals by name, ``truth`` the undisturbed states; each (n,), SI.
    """

    t: FloatArray
    input: FloatArray
    measured: Mapping[str, FloatArray]
    truth: Mapping[str, FloatArray]


def generator(seed: int, what: str) -> np.random.Generator:
    """Random numbers for one purpose, the same whatever else is drawn."""
    return np.random.default_rng([seed, crc32(what.encode())])


class Stamps:
    """When samples are taken and commands take effect, and the stamps of both.

    ``stamp_jitter`` (s) is the standard deviation of both from an even beat, which the stamps show;
    ``stamp_error`` (s) that of the stamps from the truth.
    """

    def __init__(self, values: Mapping[str, float], period: float, seed: int) -> None:
        if not 0.0 < period < math.inf:
            raise UsageError(f"the period must be a positive number of seconds, found {period:g}")
        self.period = period
        self._jitter, self._error = values["stamp_jitter"], values["stamp_error"]
        self._late, self._lies = generator(seed, "stamp_jitter"), generator(seed, "stamp_error")
        self._beat = 0

    def ends(self, now: float, n: int) -> FloatArray:
        """Ends (n,) of the next sample periods, s."""
        beats = self._beat + np.arange(1, n + 1)
        self._beat += n
        if not self._jitter:
            return np.asarray(self.period * beats)
        most = LARGEST_JITTER * self.period
        late = self._jitter * self._late.standard_normal(n)
        return np.asarray(self.period * beats + np.minimum(np.maximum(late, -most), most))

    def seen(self, t: FloatArray) -> FloatArray:
        """The stamps of the true times ``t`` (n,)."""
        return t + self._error * self._lies.standard_normal(len(t)) if self._error else t


class Noise:
    """Noise of unit variance and a correlation between neighbours (AR(1)) that goes on from call to call."""

    def __init__(self, random: np.random.Generator, correlation: float) -> None:
        self._random, self._share = random, correlation
        self._fresh = math.sqrt(1.0 - correlation**2)
        self._last: float | None = None
        self._ready, self._used = np.empty(0), 0

    def draw(self, n: int) -> FloatArray:
        """The next n samples."""
        noise = self._white(n)
        if not self._share or not n:
            return noise
        if self._last is None:
            # the very first sample has no one before it, and is as large as the others
            noise[1:] *= self._fresh
        else:
            noise *= self._fresh
        before = self._share * (self._last or 0.0)
        if n == 1:
            noise[0] += before
        else:
            # a twin makes sample by sample, and starts in half the time without
            from scipy.signal import lfilter

            noise = np.asarray(lfilter([1.0], [1.0, -self._share], noise, zi=[before])[0])
        self._last = float(noise[-1])
        return noise

    def _white(self, n: int) -> FloatArray:
        """The next n of unit variance, drawn many at a time: a rig that is stepped asks for one by one."""
        if self._used + n > len(self._ready):
            left = self._ready[self._used :]
            self._ready = np.append(left, self._random.standard_normal(max(n - len(left), AT_ONCE)))
            self._used = 0
        self._used += n
        return self._ready[self._used - n : self._used].copy()


class Channel:
    """How one quantity is sampled: noise (standard deviation) and resolution, SI."""

    def __init__(self, values: Mapping[str, float], name: str, seed: int, resolution: float = 0.0) -> None:
        self.noise = values[f"{name}_noise"]
        self.resolution = resolution or values.get(f"{name}_resolution", 0.0)
        self._source = Noise(generator(seed, name), values["noise_correlation"])

    def sample(self, x: FloatArray) -> FloatArray:
        """Samples (n,) of the true values ``x`` (n,)."""
        seen = x + self.noise * self._source.draw(len(x))
        return np.rint(seen / self.resolution) * self.resolution if self.resolution else seen


def sense(x: FloatArray, values: Mapping[str, float], channel: str = "") -> FloatArray:
    """What a sensor with nonlinearity, gain error and offset makes of ``x`` (n,), lagged already.

    A second ``channel`` (with "_" at its end) has a gain error and an offset of its own.
    """
    if not channel:
        x = x + values.get("sensor_nonlinearity.cubic", 0.0) * x**3
    gain = 1.0 + values.get(f"sensor_gain.{channel}gain", 0.0)
    return np.asarray(gain * x + values.get(f"sensor_offset.{channel}offset", 0.0))
