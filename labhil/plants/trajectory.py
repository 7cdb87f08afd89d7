"""Result of a simulation: samples as a rig records them, their noise and times, and the true states."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from labhil.errors import UsageError
from labhil.signals import FloatArray

MAX_JITTER = 0.4
"""Largest jitter as a share of the period."""

BLOCK_SIZE = 256
"""Number of random numbers that are drawn at once."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Samples of a simulation, (n,) each, SI.

    Attributes:
        t: Time stamps, s.
        input: Recorded input.
        measured: Measured signals by name.
        truth: True states by name.
    """

    t: FloatArray
    input: FloatArray
    measured: Mapping[str, FloatArray]
    truth: Mapping[str, FloatArray]


def random_generator(seed: int, what: str) -> np.random.Generator:
    """Make the random generator of a purpose; it does not depend on what else is drawn."""
    return np.random.default_rng([seed, crc32(what.encode())])


class SampleTimes:
    """Times of samples and commands, and their time stamps.

    Args:
        values: ``stamp_jitter`` is the standard deviation of the times from an even clock, ``stamp_error``
            that of the time stamps from the times, s.
        period: Period of the even clock, s.
        seed: Seed of the random numbers.
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
        """Return the ends (n,) of the next sample periods, s."""
        samples = self._n_samples + np.arange(1, n + 1)
        self._n_samples += n
        if not self._jitter:
            return np.asarray(self.period * samples)
        limit = MAX_JITTER * self.period
        jitter = self._jitter * self._jitter_source.standard_normal(n)
        return np.asarray(self.period * samples + np.minimum(np.maximum(jitter, -limit), limit))

    def recorded(self, t: FloatArray) -> FloatArray:
        """Return the time stamps of the true times ``t`` (n,)."""
        return t + self._error * self._error_source.standard_normal(len(t)) if self._error else t


class Noise:
    """First-order autoregressive noise of unit variance that continues from call to call."""

    def __init__(self, random: np.random.Generator, correlation: float) -> None:
        self._random, self._correlation = random, correlation
        self._innovation = math.sqrt(1.0 - correlation**2)
        self._last: float | None = None
        self._block, self._used = np.empty(0), 0

    def draw(self, n: int) -> FloatArray:
        """Draw the next n samples."""
        noise = self._draw_white(n)
        if not self._correlation or not n:
            return noise
        if self._last is None:
            # the very first sample has no predecessor, and the same variance as the others
            noise[1:] *= self._innovation
        else:
            noise *= self._innovation
        previous = self._correlation * (self._last or 0.0)
        if n == 1:
            noise[0] += previous
        else:
            # a twin draws single samples, and starts in half the time without this import
            from scipy.signal import lfilter

            noise = np.asarray(lfilter([1.0], [1.0, -self._correlation], noise, zi=[previous])[0])
        self._last = float(noise[-1])
        return noise

    def _draw_white(self, n: int) -> FloatArray:
        """Draw the next n of white noise, in blocks: a plant that is stepped needs single samples."""
        if self._used + n > len(self._block):
            rest_of_block = self._block[self._used :]
            self._block = np.append(
                rest_of_block, self._random.standard_normal(max(n - len(rest_of_block), BLOCK_SIZE))
            )
            self._used = 0
        self._used += n
        return self._block[self._used - n : self._used].copy()


class Channel:
    """Noise (standard deviation) and resolution of a measured signal, SI."""

    def __init__(self, values: Mapping[str, float], name: str, seed: int, resolution: float = 0.0) -> None:
        self.noise = values[f"{name}_noise"]
        self.resolution = resolution or values.get(f"{name}_resolution", 0.0)
        self._noise = Noise(random_generator(seed, name), values["noise_correlation"])

    def sample(self, x: FloatArray) -> FloatArray:
        """Sample the true values ``x`` (n,)."""
        values = x + self.noise * self._noise.draw(len(x))
        return np.rint(values / self.resolution) * self.resolution if self.resolution else values


def sense(x: FloatArray, values: Mapping[str, float], channel: str = "") -> FloatArray:
    """Apply nonlinearity, gain error and offset of a sensor to ``x`` (n,).

    A second ``channel`` (with "_" at its end) has its own gain error and offset.
    """
    if not channel:
        x = x + values.get("sensor_nonlinearity.cubic", 0.0) * x**3
    gain = 1.0 + values.get(f"sensor_gain.{channel}gain", 0.0)
    return np.asarray(gain * x + values.get(f"sensor_offset.{channel}offset", 0.0))
