"""The sensor of the ball: from its true position to the count of the converter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labhil.signals import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Sensor:
    """Potentiometer and converter; the plant simulates the lag (s), the rest acts on single samples."""

    lag: float
    cubic: float
    gain: float
    offset: float
    noise: float
    bits: int
    full_scale: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Sensor:
        """Take it from the parameters of a plant."""
        return cls(
            lag=values.get("sensor_lag.time_constant", 0.0),
            cubic=values.get("sensor_nonlinearity.cubic", 0.0),
            gain=values.get("sensor_gain.gain", 0.0),
            offset=values.get("sensor_offset.offset", 0.0),
            noise=values["position_noise"],
            bits=int(values["adc_bits"]),
            full_scale=values["adc_range"],
        )

    @property
    def scale(self) -> float:
        """Metres per count."""
        return self.full_scale / (1 << self.bits)

    @property
    def zero(self) -> int:
        """The count of position zero."""
        return 1 << (self.bits - 1)

    def counts(self, lagged: FloatArray, noise: FloatArray) -> IntArray:
        """Return the counts for positions (m, any shape); ``noise`` has unit variance and the same shape."""
        seen = (1.0 + self.gain) * (lagged + self.cubic * lagged**3) + self.offset + self.noise * noise
        counts = np.rint(seen / self.scale) + self.zero
        return np.asarray(np.clip(counts, 0, (1 << self.bits) - 1), dtype=np.int64)

    def position(self, counts: IntArray) -> FloatArray:
        """Return the positions (m) of counts."""
        return np.asarray((counts - self.zero) * self.scale, dtype=np.float64)
