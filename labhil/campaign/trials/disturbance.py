"""Disturbances of a rig that no model has: a random force at its drive, or a drift of the drive's gain.

They are in no recording: the recorded command is the one that was sent.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.signal import lfilter

from labhil.errors import UsageError
from labhil.signals import FloatArray

SIZE_RANGE = (0.5, 3.0)
"""RMSE that a disturbance adds to a model of everything else, in noise levels."""

CORRELATION_TIMES = (0.05, 0.5)
"""Correlation time of a random force, s."""


class DisturbanceKind(StrEnum):
    """Kinds of disturbance."""

    FORCE = "force"
    DRIFT = "drift"


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A random force, an Ornstein-Uhlenbeck process, or a gain of the drive that drifts.

    Attributes:
        kind: the kind.
        size: standard deviation of the force in the command's unit, or the largest relative change of gain.
        lasts: correlation time of the force, s.
        phase: initial phase of the gain's drift, rad; a recording is one period of it.
    """

    kind: DisturbanceKind
    size: float
    lasts: float
    phase: float

    @classmethod
    def draw(cls, kind: DisturbanceKind, rng: np.random.Generator) -> Disturbance:
        """Draw a disturbance of unit size."""
        correlation_time = float(np.exp(rng.uniform(*np.log(CORRELATION_TIMES))))
        return cls(kind, 1.0, correlation_time, float(rng.uniform(-np.pi, np.pi)))

    def sample(self, count: int, period: float, seed: int) -> tuple[FloatArray, FloatArray]:
        """Return factor and summand (count,) that turn commands into what acts."""
        if self.kind is DisturbanceKind.DRIFT:
            swing = 2.0 * np.pi * np.arange(count) / max(count - 1, 1) + self.phase
            return 1.0 + self.size * np.sin(swing), np.zeros(count)
        autocorrelation = float(np.exp(-period / self.lasts))
        steps = np.random.default_rng([seed, 2]).standard_normal(count)
        steps[1:] *= np.sqrt(1.0 - autocorrelation**2)
        return np.ones(count), self.size * np.asarray(lfilter([1.0], [1.0, -autocorrelation], steps))


def parse_disturbance(name: str | None) -> DisturbanceKind | None:
    """Return the kind of a name, None for None.

    Raises:
        UsageError: there is no such kind.
    """
    if name is None:
        return None
    try:
        return DisturbanceKind(name)
    except ValueError:
        raise UsageError(f"--disturbed: expected force or drift, found {name!r}") from None
