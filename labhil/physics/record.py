"""Measured signals as identification uses them, and the stretches of them that are simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from labhil.recording.clock_faults import ClockFault
from labhil.signals import FloatArray, Hold, IntArray

if TYPE_CHECKING:
    from labhil.physics.smoothing import Smoothing

PERIODS_BETWEEN_RECORDINGS = 20.0
"""Gap between two recordings that are joined into one record, in sampling periods."""

MAX_HORIZON_SHARE = 0.4
"""Longest horizon over the duration of a recording: two horizons, and half of one before them, fit in."""

UNREAD = 2
"""Value of ``Record.censored`` where a reading was wrong: the number in its place was not measured."""

WHITE_NOISE_AUTOCORRELATION = (1.0, 0.0, 0.0, 0.0)
"""Autocorrelation of white noise at lags of 0 to 3 rows."""


@dataclass(frozen=True, slots=True)
class Begin:
    """The start of one recording within a record: its first sample ``row`` and its ``number``, from 1.

    ``shift`` is the time of the record minus the recording's own, s; ``noise_scale`` (channels,) the noise of
    its outputs over that of the record, empty if not estimated; ``clock_faults`` are faults of its time
    stamps; ``input_smoothing`` is the smoothing of the first input where that is the reading of a sensor;
    ``left_out`` counts the samples of a long recording that are not used.
    """

    row: int = 0
    number: int = 1
    shift: float = 0.0
    noise_scale: tuple[float, ...] = ()
    clock_faults: tuple[ClockFault, ...] = ()
    input_smoothing: Smoothing | None = None
    left_out: int = 0


@dataclass(frozen=True)
class Record:
    """The measured signals of one recording, or of several joined one after another (``physics.joining``).

    ``t`` (n,) s, increasing; ``inputs`` (n, inputs) and ``outputs`` (n, channels) in SI units;
    ``input_holds`` (inputs,) is what each input does between samples; ``auxiliary`` are other channels, each
    (n,), by column name; ``output_joints`` (channels,) is the joint of each output, None for none. ``begins``
    marks the start of each recording: no simulation crosses from one into the next. ``least_noise``
    (channels,) is a lower bound of the standard deviation of each output's noise from the whole recording (a
    part at rest shows none), empty if not known. ``censored`` (n, channels) is +1 for a reading at the upper
    end of its range (the true value is at least that), −1 at the lower end, ``UNREAD`` for a value that was
    not measured, else 0; None if every value is a reading.
    """

    t: FloatArray
    inputs: FloatArray
    outputs: FloatArray
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_holds: tuple[Hold, ...] = (Hold.LINEAR,)
    auxiliary: Mapping[str, FloatArray] = field(default_factory=dict)
    output_joints: tuple[int | None, ...] = ()
    begins: tuple[Begin, ...] = (Begin(),)
    least_noise: tuple[float, ...] = ()
    censored: IntArray | None = None

    def __len__(self) -> int:
        return len(self.t)

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First and one-past-last sample of each recording."""
        rows = [begin.row for begin in self.begins]
        return list(zip(rows, [*rows[1:], len(self)], strict=True))

    def recordings(self) -> tuple[Record, ...]:
        """Split into single recordings, each with its number and its own time."""
        if len(self.begins) == 1 and not self.begins[0].shift:
            return (self,)
        return tuple(
            replace(part, t=part.t - begin.shift, begins=(replace(begin, row=0, shift=0.0),))
            for begin, (first, last) in zip(self.begins, self.spans, strict=True)
            for part in [self.part(first, last)]
        )

    def own_time(self, row: int) -> tuple[int, float]:
        """Number of the recording that sample ``row`` belongs to, and the time in that recording, s."""
        begin = next(b for b in reversed(self.begins) if b.row <= row)
        return begin.number, float(self.t[row] - begin.shift)

    @property
    def durations(self) -> list[float]:
        """Time from the first to the last sample of each recording, s."""
        return [float(self.t[last - 1] - self.t[first]) for first, last in self.spans]

    @property
    def duration(self) -> float:
        """Sum of the durations of all recordings, s."""
        return sum(self.durations)

    @property
    def max_horizon(self) -> float:
        """Longest horizon with which every recording can be scored (``MAX_HORIZON_SHARE``), s."""
        return MAX_HORIZON_SHARE * min(self.durations)

    @property
    def longest(self) -> float:
        """Duration of the longest recording, s: no window can be longer."""
        return max(self.durations)

    @cached_property
    def period(self) -> float:
        """Sampling period: median time between samples, s."""
        return float(np.median(np.diff(self.t)))

    @property
    def autocorrelation(self) -> tuple[float, ...]:
        """Autocorrelation at lags of 0 to 3 rows that filtering gave to white measurement noise."""
        return WHITE_NOISE_AUTOCORRELATION

    def with_holds(self, holds: Mapping[str, Hold]) -> Record:
        """Copy with the input holds ``holds``, given by column name."""
        input_holds = tuple(holds.get(n, h) for n, h in zip(self.input_names, self.input_holds, strict=False))
        return self if input_holds == self.input_holds else replace(self, input_holds=input_holds)

    def channel(self, j: int) -> tuple[str, int | None]:
        """Signal name and joint of output column ``j``; the joint is None where the signal has none."""
        joint = self.output_joints[j] if self.output_joints else None
        name = self.output_names[j]
        return (name if joint is None else name.removesuffix(f"_{joint}")), joint

    def part(self, first: int, last: int) -> Record:
        """Cut out the samples first … last − 1."""
        begins = [self.begins[k] for k in self.within(first, last)]
        return replace(
            self,
            t=self.t[first:last],
            inputs=self.inputs[first:last],
            outputs=self.outputs[first:last],
            auxiliary={name: values[first:last] for name, values in self.auxiliary.items()},
            begins=tuple(replace(begin, row=max(begin.row - first, 0)) for begin in begins) or (Begin(),),
            censored=None if self.censored is None else self.censored[first:last],
        )

    @property
    def has_joints(self) -> bool:
        """Whether an output belongs to a joint: the record is of an arm."""
        return any(joint is not None for joint in self.output_joints)

    def within(self, first: int, last: int) -> list[int]:
        """Indices (from 0) of the recordings with samples among first … last − 1."""
        return [k for k, (a, b) in enumerate(self.spans) if max(a, first) < min(b, last)]

    def followed_by(self, others: Sequence[Record]) -> Record:
        """Append other recordings with the same channels; recordings are numbered in order, from 1."""
        records = (self, *others)
        begins, row, next_start = list[Begin](), 0, float(self.t[0])
        for number, record in enumerate(records, 1):
            shift = next_start - float(record.t[0]) if row else 0.0
            begins.append(replace(record.begins[0], row=row, number=number, shift=shift, noise_scale=()))
            row, next_start = (
                row + len(record),
                float(record.t[-1]) + shift + PERIODS_BETWEEN_RECORDINGS * self.period,
            )
        return replace(
            self,
            t=np.concatenate(
                [r.t + b.shift if b.shift else r.t for r, b in zip(records, begins, strict=True)]
            ),
            inputs=np.concatenate([record.inputs for record in records]),
            outputs=np.concatenate([record.outputs for record in records]),
            auxiliary={
                name: np.concatenate([record.auxiliary[name] for record in records])
                for name in self.auxiliary
            },
            begins=tuple(begins),
            least_noise=_common_floor(records),
            censored=_censored_of(records),
        )


def _common_floor(records: Sequence[Record]) -> tuple[float, ...]:
    """Lower bound of the noise that holds for all records; empty if one record has none."""
    if not all(record.least_noise for record in records):
        return ()
    return tuple(np.min([record.least_noise for record in records], axis=0).tolist())


def _censored_of(records: Sequence[Record]) -> IntArray | None:
    """Concatenated censoring marks; None if no record has any."""
    if all(record.censored is None for record in records):
        return None
    return np.concatenate(
        [
            np.zeros(record.outputs.shape, dtype=np.int64) if record.censored is None else record.censored
            for record in records
        ]
    )


@dataclass(frozen=True, slots=True)
class Windows:
    """Stretches of a record, each simulated from its own initial state.

    Window w covers the samples first[w] … last[w] − 1. Simulated arrays have the samples of all windows one
    after another: ``rows`` (N,) are their sample numbers and ``owner`` (N,) is the window of each.
    """

    first: IntArray
    last: IntArray
    rows: IntArray
    owner: IntArray

    def __len__(self) -> int:
        return len(self.first)

    @classmethod
    def of(cls, spans: Sequence[tuple[int, int]]) -> Windows:
        """Make windows of (first, last) pairs."""
        first = np.array([a for a, _ in spans], dtype=np.int64)
        last = np.array([b for _, b in spans], dtype=np.int64)
        return cls._between(first, last)

    def select(self, chosen: IntArray) -> Windows:
        """Some of these windows, by their indices (K,)."""
        return self._between(self.first[chosen], self.last[chosen])

    def split(self, count: int) -> list[tuple[slice, Windows]]:
        """Split into at most ``count`` parts of neighbouring windows, with about as many samples each.

        Returns:
            The place of each part among these windows, and its windows.
        """
        ends = np.cumsum(self.last - self.first)
        cuts = np.searchsorted(ends, len(self.rows) * np.arange(1, count) / count) + 1
        edges = np.unique(np.clip([0, *cuts.tolist(), len(self)], 0, len(self))).tolist()
        places = [slice(first, last) for first, last in pairwise(edges)]
        return [(place, self._between(self.first[place], self.last[place])) for place in places]

    @classmethod
    def _between(cls, first: IntArray, last: IntArray) -> Windows:
        owner = np.repeat(np.arange(len(first), dtype=np.int64), last - first)
        before = np.cumsum(last - first) - last
        return cls(first, last, np.arange(len(owner), dtype=np.int64) - before[owner], owner)
