"""The true measurement noise of a trial, which only the oracle knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from labhil.physics.arm.motion import PreparedRecord
from labhil.physics.record import Record
from labhil.signals import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class TrueNoise:
    """Noise of each output: ``level`` (c,) before a converter of ``step`` (c,), in the channel's unit.

    Neighbouring samples are correlated by ``correlation`` (AR(1)); rounding counts as white noise of
    variance step²/12, which it is where the motion or the noise crosses steps.
    """

    level: tuple[float, ...]
    step: tuple[float, ...]
    correlation: float

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation of each output's noise (c,), rounding included."""
        return np.hypot(np.array(self.level), np.array(self.step) / np.sqrt(12.0))

    def residual_in(self, record: Record) -> ResidualNoise:
        """Return the noise in a record that a model has prepared (filtered, for an arm)."""
        rounded = (np.array(self.step) ** 2 / 12.0) / np.maximum(self.sigma**2, 1e-300)
        motion = record.motion if isinstance(record, PreparedRecord) else None
        if not isinstance(record, PreparedRecord) or motion is None or motion.low_pass is None:
            places = np.arange(len(record))
            judged = np.ones(record.outputs.shape, dtype=bool)
            coloured = np.asarray(self.correlation ** np.arange(len(record)), dtype=np.float64)
            white = np.asarray(0.0 ** np.arange(len(record)), dtype=np.float64)
        else:
            places, judged = record.places, motion.judged[record.places]
            coloured = motion.low_pass.autocovariance(int(places[-1] - places[0]) + 1, self.correlation)
            white = motion.low_pass.autocovariance(len(coloured))
        return ResidualNoise(self.sigma, rounded, coloured, white, places, judged)

    def to_json(self) -> dict[str, Any]:
        """Return the noise as plain JSON data."""
        return {"level": list(self.level), "step": list(self.step), "correlation": self.correlation}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> TrueNoise:
        """Read what :meth:`to_json` wrote."""
        return cls(tuple(data["level"]), tuple(data["step"]), float(data["correlation"]))


@dataclass(frozen=True, slots=True, eq=False)
class ResidualNoise:
    """Noise in the rows of a prepared record.

    Attributes:
        measured: standard deviation (c,) before preparation.
        rounded: share (c,) of rounding in its square.
        coloured: autocovariance of coloured unit noise by distance in samples, after preparation.
        white: that of white unit noise.
        places: index (n,) of each row in samples.
        judged: rows (n, c) that are compared with a model; only these have noise.
    """

    measured: FloatArray
    rounded: FloatArray
    coloured: FloatArray
    white: FloatArray
    places: IntArray
    judged: np.ndarray

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation (c,) of a judged row."""
        return np.asarray(self.measured * np.sqrt(self._variance))

    @property
    def _variance(self) -> FloatArray:
        """Variance (c,) of unit noise after preparation, rounding included."""
        return np.asarray(self.coloured[0] + self.rounded * (self.white[0] - self.coloured[0]))

    @property
    def rms(self) -> FloatArray:
        """Root mean square (c,) over all rows, judged or not."""
        return np.asarray(self.sigma * np.sqrt(self.judged.mean(axis=0)))

    def correlation(self, channel: int, rows: IntArray) -> FloatArray:
        """Return the correlation matrix of an output's noise in these rows."""
        share = self.rounded[channel]
        autocovariance = (1.0 - share) * self.coloured + share * self.white
        at = self.places[rows]
        return np.asarray((autocovariance / self._variance[channel])[np.abs(at[:, None] - at)])
