"""An excitation: a function of the step's time, for one command or for the columns of a vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, sqrt
from typing import Protocol

import numpy as np

from labhil.signals import FloatArray

Seed = int | tuple[int, ...]
"""Seed of a numpy generator: one number, or a sequence of numbers."""


class Excitation(Protocol):
    """A scalar function of time: s since the step began → value in the unit of the signal that it drives."""

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        ...


@dataclass(frozen=True, slots=True)
class Excitations:
    """The excitation of a vector signal such as six joints: one function for each of its columns."""

    columns: tuple[Excitation, ...]


def columns_of(excitation: Excitation | Excitations) -> tuple[Excitation, ...]:
    """Return the excitation of each column; a scalar signal has one."""
    return excitation.columns if isinstance(excitation, Excitations) else (excitation,)


def sample(excitation: Excitation | Excitations, t: Sequence[float] | FloatArray) -> FloatArray:
    """Evaluate an excitation at given times.

    Args:
        excitation: A scalar or vector excitation.
        t: Times (n,), s since the step began.

    Returns:
        Values (n,), or (n, columns) of a vector excitation.
    """
    if isinstance(excitation, Excitations):
        return np.column_stack([sample(column, t) for column in excitation.columns])
    times = np.asarray(t, dtype=np.float64)
    return np.fromiter((excitation(time) for time in times.tolist()), dtype=np.float64, count=len(times))


def sample_at_rate(
    excitation: Excitation | Excitations, duration: float, rate: float, *, max_samples: int = 20_000_000
) -> FloatArray:
    """Evaluate an excitation at a constant rate, beginning at t = 0.

    Args:
        excitation: A scalar or vector excitation.
        duration: Duration, s.
        rate: Sample rate, Hz.
        max_samples: Number of samples at most. The default is half an hour at 10 kHz, which takes 20 s.

    Returns:
        Values (n,), or (n, columns) of a vector excitation.

    Raises:
        ValueError: There would be more than ``max_samples``.
    """
    if not duration * rate <= max_samples:
        raise ValueError(
            f"expected at most {max_samples / rate:.6g} s at {rate:g} Hz, found {duration:g} s; "
            "make several steps of it"
        )
    return sample(excitation, np.arange(max(round(duration * rate), 1)) / rate)


def crest_factor(values: FloatArray) -> float:
    """Return the crest factor of values (n,), max|x|/RMS(x); inf for a signal that is zero."""
    rms = sqrt(float(np.mean(np.square(values))))
    return float(np.max(np.abs(values))) / rms if rms > 0 else inf
