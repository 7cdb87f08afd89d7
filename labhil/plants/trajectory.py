"""What a plant's simulation gives: samples as a bench would record them, and the truth behind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from labhil.errors import UsageError
from labhil.signals import FloatArray

MAX_JITTER = 0.4
"""Share of a period by which a sample is early or late at most."""

BLOCK_SIZE = 256
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


def random_generator(seed: int, what: str) -> np.random.Generator:
    """Random numbers for one purpose, the same whatever else is drawn."""
    return np.random.default_rng([seed, crc32(what.encode())])


class SampleTimes:
    """When samples are taken and commands take effect, and the stamps of both.

    ``stamp_jitter`` (s) is the standard deviation of both from an even beat, which the stamps show;
    ``stamp_error`` (s) that of the stamps from the truth.
    """

    def __init__(self, values: Mapping[str, float], period: float, seed: int) -> None:
        if not 0.0 < period < math.inf:
            raise UsageError(f"the period must be a positive number of seconds, found {period:g}")
        self.period = period
        self._jitter, self._error = values["stamp_jitter"], values["stamp_error"]
        self._jitter_source, self._error_source = (
            random_generator(seed, "stamp_jitter"),
            random_generator(seed, "stamp_error"),
        )
        self._n_samples = 0

    def ends(self, now: float, n: int) -> FloatArray:
        """Ends (n,) of the next sample periods, s."""
        samples = self._n_samples + np.arange(1, n + 1)
        self._n_samples += n
        if not self._jitter:
            return np.asarray(self.period * samples)
        limit = MAX_JITTER * self.period
        jitter = self._jitter * self._jitter_source.standard_normal(n)
        return np.asarray(self.period * samples + np.minimum(np.maximum(jitter, -limit), limit))

    def recorded(self, t: FloatArray) -> FloatArray:
        """The stamps of the true times ``t`` (n,)."""
        return t + self._error * self._error_source.standard_normal(len(t)) if self._error else t


class Noise:
    """Noise of unit variance and a correlation between neighbours (AR(1)) that goes on from call to call."""

    def __init__(self, random: np.random.Generator, correlation: float) -> None:
        self._random, self._correlation = random, correlation
        self._innovation = math.sqrt(1.0 - correlation**2)
        self._last: float | None = None
        self._block, self._used = np.empty(0), 0

    def draw(self, n: int) -> FloatArray:
        """The next n samples."""
        noise = self._draw_white(n)
        if not self._correlation or not n:
            return noise
        if self._last is None:
            # the very first sample has no one before it, and is as large as the others
            noise[1:] *= self._innovation
        else:
            noise *= self._innovation
        previous = self._correlation * (self._last or 0.0)
        if n == 1:
            noise[0] += previous
        else:
            # a twin makes sample by sample, and starts in half the time without
            from scipy.signal import lfilter

            noise = np.asarray(lfilter([1.0], [1.0, -self._correlation], noise, zi=[previous])[0])
        self._last = float(noise[-1])
        return noise

    def _draw_white(self, n: int) -> FloatArray:
        """The next n of unit variance, drawn many at a time: a rig that is stepped asks for one by one."""
        if self._used + n > len(self._block):
            rest_of_block = self._block[self._used :]
            self._block = np.append(
                rest_of_block, self._random.standard_normal(max(n - len(rest_of_block), BLOCK_SIZE))
            )
            self._used = 0
        self._used += n
        return self._block[self._used - n : self._used].copy()


class Channel:
    """How one quantity is sampled: noise (standard deviation) and resolution, SI."""

    def __init__(self, values: Mapping[str, float], name: str, seed: int, resolution: float = 0.0) -> None:
        self.noise = values[f"{name}_noise"]
        self.resolution = resolution or values.get(f"{name}_resolution", 0.0)
        self._noise = Noise(random_generator(seed, name), values["noise_correlation"])

    def sample(self, x: FloatArray) -> FloatArray:
        """Samples (n,) of the true values ``x`` (n,)."""
        values = x + self.noise * self._noise.draw(len(x))
        return np.rint(values / self.resolution) * self.resolution if self.resolution else values


def sense(x: FloatArray, values: Mapping[str, float], channel: str = "") -> FloatArray:
    """What a sensor with nonlinearity, gain error and offset makes of ``x`` (n,), lagged already.

    A second ``channel`` (with "_" at its end) has a gain error and an offset of its own.
    """
    if not channel:
        x = x + values.get("sensor_nonlinearity.cubic", 0.0) * x**3
    gain = 1.0 + values.get(f"sensor_gain.{channel}gain", 0.0)
    return np.asarray(gain * x + values.get(f"sensor_offset.{channel}offset", 0.0))
