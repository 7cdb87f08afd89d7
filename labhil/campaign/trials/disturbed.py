"""What disturbs a rig in a trial beside what is concealed: a random force at its drive, or its gain's drift.

No recording knows of it: the command that is recorded is the one that was sent.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.signal import lfilter

from labhil.errors import UsageError
from labhil.signals import FloatArray

SIZES = (0.5, 3.0)
"""Noise levels of the RMSE that a disturbance adds to a model of everything else."""

LASTS = (0.05, 0.5)
"""Correlation time of a random force, s."""


class Kind(StrEnum):
    """Sorts of disturbance."""

    FORCE = "force"
    DRIFT = "drift"


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A random force, an Ornstein-Uhlenbeck process, or a gain of the drive that drifts.

    Attributes:
        kind: which of them.
        size: standard deviation of the force in the command's unit, or the largest relative change of gain.
        lasts: correlation time of the force, s.
        phase: where in its slow swing a gain begins, rad; it goes through one swing in a recording.
    """

    kind: Kind
    size: float
    lasts: float
    phase: float

    @classmethod
    def draw(cls, kind: Kind, random: np.random.Generator) -> Disturbance:
        """One of unit size."""
        lasts = float(np.exp(random.uniform(*np.log(LASTS))))
        return cls(kind, 1.0, lasts, float(random.uniform(-np.pi, np.pi)))

    def sample(self, count: int, period: float, seed: int) -> tuple[FloatArray, FloatArray]:
        """Factor and summand (count,) by which what acts differs from the commands."""
        if self.kind is Kind.DRIFT:
            swing = 2.0 * np.pi * np.arange(count) / max(count - 1, 1) + self.phase
            return 1.0 + self.size * np.sin(swing), np.zeros(count)
        kept = float(np.exp(-period / self.lasts))
        steps = np.random.default_rng([seed, 2]).standard_normal(count)
        steps[1:] *= np.sqrt(1.0 - kept**2)
        return np.ones(count), self.size * np.asarray(lfilter([1.0], [1.0, -kept], steps))


def kind_of(word: str | None) -> Kind | None:
    """The kind that a word names, None for None; UsageError for another word."""
    if word is None:
        return None
    try:
        return Kind(word)
    except ValueError:
        raise UsageError(f"--disturbed: expected force or drift, found {word!r}") from None
