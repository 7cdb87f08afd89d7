"""An excitation: a function of the step's time, for one command or for the columns of a vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, sqrt
from typing import Protocol

import numpy as np

from labhil.signals import FloatArray

Seed = int | tuple[int, ...]
"""What numpy's generators are begun with: one number, or several that stand for one."""


MOST_SAMPLES = 20_000_000
"""Values of one step, which are all looked at before a run: half an hour at 10 kHz; they take 20 s."""


class Excitation(Protocol):
    """A function of time: s since the step began, to the unit of the signal that it drives."""

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        ...


@dataclass(frozen=True, slots=True)
class Excitations:
    """What drives a vector such as six joints: one excitation for each of its columns."""

    columns: tuple[Excitation, ...]


def columns_of(excitation: Excitation | Excitations) -> tuple[Excitation, ...]:
    """Return the excitation of each column: one alone for a plain signal."""
    return excitation.columns if isinstance(excitation, Excitations) else (excitation,)


def sample(excitation: Excitation | Excitations, t: Sequence[float] | FloatArray) -> FloatArray:
    """Return the values at the times ``t`` (n,) in s: (n,), or (n, columns) for a vector."""
    if isinstance(excitation, Excitations):
        return np.column_stack([sample(column, t) for column in excitation.columns])
    times = np.asarray(t, dtype=np.float64)
    return np.fromiter((excitation(time) for time in times.tolist()), dtype=np.float64, count=len(times))


def sample_at_rate(excitation: Excitation | Excitations, duration: float, rate: float) -> FloatArray:
    """Return the values at ``rate`` Hz over ``duration`` s, the first at t = 0.

    ValueError where these are more than ``MOST_SAMPLES``.
    """
    if not duration * rate <= MOST_SAMPLES:
        raise ValueError(
            f"expected at most {MOST_SAMPLES / rate:.6g} s at {rate:g} Hz, found {duration:g} s; "
            "make several steps of it"
        )
    return sample(excitation, np.arange(max(round(duration * rate), 1)) / rate)


def crest_factor(values: FloatArray) -> float:
    """Return the peak of the absolute value over the root mean square; inf for a signal that is zero."""
    rms = sqrt(float(np.mean(np.square(values))))
    return float(np.max(np.abs(values))) / rms if rms > 0 else inf
