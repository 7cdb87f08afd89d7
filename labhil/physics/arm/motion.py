"""The motion behind an arm's record: even raster, one zero-phase low-pass for everything, accelerations.

Angles, velocities and currents pass the same filter (parallel filtering: what it does to a current it also
does to the model of that current). It is a fourth-order Butterworth low-pass run forwards and backwards;
its cut-off is ten times the frequency below which 99 % of the velocities' power lies, between 8 Hz and a
third of the sampling rate. Accelerations are central differences of the filtered velocities. Laws with a
step (dry friction, ripple) are computed at the full rate and then filtered too. What is kept is every so
many samples, 2.5 times the cut-off per second, so that neighbours know little of each other.

Where a joint rests, dry friction takes any value within its level and no model can predict the current:
such samples (|q̇| below ``REST`` within the filter's reach) are not judged. Where all joints rest,
near the ends, and where samples are missing, nothing is kept at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy import signal

from labhil.errors import RecordingError
from labhil.physics.model import WHITE, Record
from labhil.signals import FloatArray

REST = 0.01
"""rad/s; a joint that is slower is taken to be at rest."""

LOWEST_CUT_OFF = 8.0
HIGHEST_SHARE = 1.0 / 3.0
BANDWIDTHS = 10.0
SLOWER = 3.0
POWER = 0.99
KEPT_PER_CUT_OFF = 2.5
GAP = 2.5
"""A place farther than this many periods from both neighbours' span is missing."""

PLACE = "sample_of_motion"
"""Auxiliary channel of a prepared record: where each of its rows stands in the motion."""

FEWEST = 30

REACHES = 40
"""How far a filter is followed, in its own reaches: nothing is left of an impulse there."""


@dataclass(frozen=True, slots=True)
class LowPass:
    """A zero-phase low-pass at ``cut_off`` Hz for samples every ``period`` s."""

    cut_off: float
    period: float

    @property
    def reach(self) -> int:
        """Samples on either side that a sample is made of, for the most part."""
        return max(1, round(0.35 / (self.cut_off * self.period)))

    def __call__(self, columns: FloatArray) -> FloatArray:
        """Filter columns (n, …) along time.

        As ``scipy.signal.sosfiltfilt``, which works out the filter's state at rest anew for every column.
        """
        sections, at_rest = _sections(2.0 * self.cut_off * self.period)
        edge = 3 * (2 * len(sections) + 1)
        if len(columns) <= edge:
            return np.asarray(signal.sosfiltfilt(sections, columns, axis=0))
        before, after = (
            2.0 * columns[:1] - columns[edge:0:-1],
            2.0 * columns[-1:] - columns[-2 : -edge - 2 : -1],
        )
        padded = np.concatenate([before, columns, after])
        at_rest = at_rest.reshape(*at_rest.shape, *[1] * (columns.ndim - 1))
        for _ in range(2):
            padded = signal.sosfilt(sections, padded, axis=0, zi=at_rest * padded[0])[0][::-1]
        return np.ascontiguousarray(padded[edge:-edge])

    def autocovariance(self, n: int, correlation: float = 0.0) -> FloatArray:
        """What unit noise is like behind the filter, by distance in samples (n,), away from the ends.

        ``correlation`` is that of neighbouring samples before it (AR(1)).
        """
        m = max(REACHES * self.reach, n)
        impulse = np.zeros(2 * m + 1)
        impulse[m] = 1.0
        kernel = self(impulse)
        doubled = np.correlate(kernel, kernel, mode="full")
        distance = np.abs(np.arange(len(doubled)) - 2 * m)
        response = signal.fftconvolve(correlation**distance, doubled, mode="same") if correlation else doubled
        return np.asarray(response[2 * m : 2 * m + n])


@lru_cache
def _sections(share: float) -> tuple[FloatArray, FloatArray]:
    """Second-order sections of the low-pass that cuts off at this share of half the sampling rate.

    With the state (sections, 2) that each is in where the input has always been 1.
    """
    sections = np.asarray(signal.butter(4, share, output="sos"))
    return sections, np.asarray(signal.sosfilt_zi(sections))


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Filtered angles, velocities, accelerations, temperatures (n, 6) at ``t`` (n,), evenly spaced.

    ``judged`` (n, 6) marks where a joint moves; ``low_pass`` is None for a record that was not prepared.
    """

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    temperature: FloatArray
    judged: np.ndarray
    low_pass: LowPass | None

    @property
    def period(self) -> float:
        """Time between samples, s."""
        return float(np.median(np.diff(self.t)))

    def filtered(self, columns: FloatArray) -> FloatArray:
        """Columns (n, …) after the filter that the currents passed."""
        return columns if self.low_pass is None else self.low_pass(columns)

    def slowly(self, columns: FloatArray) -> FloatArray:
        """Columns (n, …) at the trajectory's own pace, fit to be differentiated twice more."""
        if self.low_pass is None:
            return columns
        return LowPass(self.low_pass.cut_off / SLOWER, self.low_pass.period)(columns)


@dataclass(frozen=True, slots=True)
class PreparedRecord(Record):
    """A record that was filtered and thinned out, with the motion that each recording was made of."""

    motions: tuple[Motion, ...] = field(default=(), compare=False)

    @property
    def motion(self) -> Motion | None:
        """That of a single recording."""
        return self.motions[0] if len(self.motions) == 1 else None

    def part(self, first: int, last: int) -> PreparedRecord:
        """The samples first … last − 1, with the motions of their recordings."""
        # the parent by its name: a class with slots is not the one that super() looks for
        motions = tuple(self.motions[k] for k in self.within(first, last)) if self.motions else ()
        selected = Record.part(self, first, last)
        assert isinstance(selected, PreparedRecord)
        return replace(selected, motions=motions)

    def followed_by(self, others: Sequence[Record]) -> PreparedRecord:
        """This recording and others that were prepared too."""
        records = [record for record in (self, *others) if isinstance(record, PreparedRecord)]
        combined = Record.followed_by(self, others)
        assert isinstance(combined, PreparedRecord)
        return replace(combined, motions=tuple(motion for record in records for motion in record.motions))

    @property
    def alike(self) -> tuple[float, ...]:
        """Correlation of the noise in rows 0 to 3 apart: what the filter left of white noise."""
        low_pass = self.motions[0].low_pass if self.motions else None
        if low_pass is None or len(self) < FEWEST:
            return WHITE
        every = int(np.median(np.diff(self.places)))
        correlation = low_pass.autocovariance(3 * every + 1)
        return tuple((correlation[::every] / correlation[0]).tolist())

    @property
    def places(self) -> np.ndarray:
        """Where each row stands in the motion, (n,)."""
        return np.asarray(np.rint(self.auxiliary[PLACE]), dtype=np.int64)


def cut_off_of(record: Record | None) -> float:
    """Cut-off (Hz) that leaves the trajectory of a record alone, those of all its recordings."""
    return LOWEST_CUT_OFF if record is None else max(_cut_off(recording) for recording in record.recordings())


def _cut_off(record: Record) -> float:
    if len(record) < FEWEST:
        return LOWEST_CUT_OFF
    period, joints = record.period, record.outputs.shape[1]
    grid = np.arange(record.t[0], record.t[-1], period)
    velocities = [np.interp(grid, record.t, c) for c in record.inputs[:, joints : 2 * joints].T]
    power = np.sum([np.abs(np.fft.rfft(v * np.hanning(len(v)))) ** 2 for v in velocities], axis=0)
    frequency = np.fft.rfftfreq(len(grid), period)
    share = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    edge = float(frequency[min(int(np.searchsorted(share, POWER)), len(frequency) - 1)])
    return float(np.clip(BANDWIDTHS * edge, LOWEST_CUT_OFF, max(HIGHEST_SHARE / period, LOWEST_CUT_OFF)))


def unfiltered_motion(record: Record) -> Motion:
    """The motion of a record that was not prepared: nothing filtered, accelerations by differences."""
    joints = record.outputs.shape[1]
    q, qd = record.inputs[:, :joints], record.inputs[:, joints : 2 * joints]
    qdd = np.gradient(qd, record.t, axis=0)
    return Motion(record.t, q, qd, qdd, _warmth(record), np.ones(q.shape, dtype=bool), None)


def prepare_record(record: Record, cut_off: float) -> PreparedRecord:
    """Filter a recording and keep what can be judged; RecordingError when nothing moves for long enough."""
    period, joints = record.period, record.outputs.shape[1]
    grid = record.t[0] + period * np.arange(int((record.t[-1] - record.t[0]) / period + 1e-6) + 1)
    low_pass = LowPass(min(cut_off, 0.45 / period), period)
    if len(grid) < FEWEST:
        raise RecordingError(f"too short for inverse dynamics: {len(grid)} samples, at least {FEWEST} needed")
    inputs, outputs = _on(grid, record.t, record.inputs), _on(grid, record.t, record.outputs)
    auxiliary = {name: np.interp(grid, record.t, x) for name, x in record.auxiliary.items()}
    even = replace(record, t=grid, inputs=inputs, outputs=outputs, auxiliary=auxiliary)
    q, qd = low_pass(inputs[:, :joints]), low_pass(inputs[:, joints : 2 * joints])
    qdd = np.gradient(qd, period, axis=0)
    moving = _erode(np.abs(qd) > REST, low_pass.reach)
    motion = Motion(grid, q, qd, qdd, low_pass(_warmth(even)), moving, low_pass)
    rows = _kept_rows(record.t, motion)
    if len(rows) < FEWEST:
        raise RecordingError(
            f"too little motion for inverse dynamics: {len(rows)} samples are left where a joint moves "
            f"faster than {REST:g} rad/s, at least {FEWEST} are needed"
        )
    inputs[:, :joints], inputs[:, joints : 2 * joints] = q, qd
    return PreparedRecord(
        t=grid[rows],
        inputs=inputs[rows],
        outputs=low_pass(outputs)[rows],
        input_names=record.input_names,
        output_names=record.output_names,
        output_units=record.output_units,
        input_holds=record.input_holds,
        auxiliary={n: x[rows] for n, x in auxiliary.items()} | {PLACE: rows.astype(np.float64)},
        output_joints=record.output_joints,
        begins=record.begins,
        motions=(motion,),
    )


def _kept_rows(t: FloatArray, motion: Motion) -> np.ndarray:
    """Samples to keep: thinned out, away from ends and gaps, where at least one joint moves."""
    low_pass = motion.low_pass
    assert low_pass is not None
    every = max(1, round(1.0 / (KEPT_PER_CUT_OFF * low_pass.cut_off * low_pass.period)))
    after = np.clip(np.searchsorted(t, motion.t), 1, len(t) - 1)
    usable = _erode((t[after] - t[after - 1] < GAP * low_pass.period)[:, None], low_pass.reach)[:, 0]
    usable[: 3 * low_pass.reach] = usable[-3 * low_pass.reach :] = False
    keep = usable & motion.judged.any(axis=1)
    rows = np.arange(0, len(keep), every)
    return np.asarray(rows[keep[rows]])


def _erode(flags: np.ndarray, reach: int) -> np.ndarray:
    """Flags (n, k) that hold within ``reach`` samples on both sides too."""
    wrong = np.cumsum(np.vstack([np.zeros((1, flags.shape[1]), dtype=np.int64), ~flags]), axis=0)
    n = len(flags)
    low = np.maximum(np.arange(n) - reach, 0)
    high = np.minimum(np.arange(n) + reach + 1, n)
    return np.asarray(wrong[high] == wrong[low])


def _on(grid: FloatArray, t: FloatArray, columns: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(grid, t, column) for column in columns.T])


def temperatures(record: Record) -> FloatArray | None:
    """Joint temperatures (n, 6) °C of a record; None where it has none."""
    names = [f"joint_temperatures_{j}" for j in range(record.outputs.shape[1])]
    if not all(name in record.auxiliary for name in names):
        return None
    return np.column_stack([record.auxiliary[name] for name in names])


def _warmth(record: Record) -> FloatArray:
    measured = temperatures(record)
    return np.zeros(record.outputs.shape) if measured is None else measured
