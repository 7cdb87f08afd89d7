"""The generator's own measurement noise: what an oracle knows and no analysis does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import toeplitz

from labhil.signals import FloatArray


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

    def correlations(self, n: int) -> list[FloatArray]:
        """For each output the correlation matrix (n, n) of its noise at n samples in a row."""
        coloured = toeplitz(self.correlation ** np.arange(n))
        rounded = (np.array(self.step) ** 2 / 12.0) / np.maximum(self.sigma**2, 1e-300)
        return [np.asarray((1.0 - share) * coloured + share * np.eye(n)) for share in rounded]

    def to_json(self) -> dict[str, Any]:
        """As plain JSON data."""
        return {"level": list(self.level), "step": list(self.step), "correlation": self.correlation}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> TrueNoise:
        """Read what :meth:`to_json` wrote."""
        return cls(tuple(data["level"]), tuple(data["step"]), float(data["correlation"]))
