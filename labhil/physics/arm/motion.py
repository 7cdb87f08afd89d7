"""Preparation of an arm's recording for inverse dynamics: resampling, zero-phase low-pass, accelerations.

Angles, velocities and currents pass the same filter (parallel filtering: it changes a current and the model
of that current alike), a fourth-order Butterworth low-pass run forwards and backwards. Its cut-off is ten
times the frequency below which 99 % of the velocities' power lies, between 8 Hz and a third of the sampling
rate. Accelerations are central differences of filtered velocities. Discontinuous laws (dry friction, ripple)
are computed at the full sampling rate and then filtered too. The result is thinned out to 2.5 times the
cut-off per second, so neighbouring rows are nearly uncorrelated.

At rest dry friction takes any value up to its level and no model can predict the current, so samples with
|q̇| below ``REST_VELOCITY`` within the filter's reach are not compared. Rows where all joints rest, near the
ends, and near missing samples are dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy import signal

from labhil.errors import RecordingError
from labhil.physics.record import WHITE_NOISE_AUTOCORRELATION, Record
from labhil.signals import FloatArray

REST_VELOCITY = 0.01
"""Velocity below which a joint counts as at rest, rad/s."""

MIN_CUT_OFF = 8.0
"""Lowest cut-off, Hz."""

ROWS_PER_CUT_OFF_PERIOD = 2.5
"""Rows that are kept per period of the cut-off."""

MAX_GAP_IN_PERIODS = 2.5
"""Longest step between samples, in sampling periods, that is interpolated."""

PLACE = "sample_of_motion"
"""Auxiliary channel of a prepared record: index of each row in the motion."""

MIN_SAMPLES = 30
"""Least number of samples, and of rows that are kept, for inverse dynamics."""


@dataclass(frozen=True, slots=True)
class LowPass:
    """Zero-phase low-pass with cut-off ``cut_off`` (Hz) for samples every ``period`` (s)."""

    cut_off: float
    period: float

    @property
    def reach(self) -> int:
        """Half-width of the impulse response, in samples."""
        return max(1, round(0.35 / (self.cut_off * self.period)))

    def __call__(self, columns: FloatArray) -> FloatArray:
        """Filter columns (n, …) along time.

        Equal to ``scipy.signal.sosfiltfilt``, but computes the steady state of the filter only once.
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

    def autocovariance(self, n: int, correlation: float = 0.0, *, reaches: int = 40) -> FloatArray:
        """Autocovariance of filtered unit noise at lags of 0 … n − 1 samples, away from the ends.

        Args:
            n: Number of lags.
            correlation: Correlation of neighbouring samples before the filter (AR(1)).
            reaches: Length of the impulse response, in reaches of the filter; it has decayed there.

        Returns:
            The autocovariance, (n,).
        """
        m = max(reaches * self.reach, n)
        impulse = np.zeros(2 * m + 1)
        impulse[m] = 1.0
        kernel = self(impulse)
        doubled = np.correlate(kernel, kernel, mode="full")
        distance = np.abs(np.arange(len(doubled)) - 2 * m)
        response = signal.fftconvolve(correlation**distance, doubled, mode="same") if correlation else doubled
        return np.asarray(response[2 * m : 2 * m + n])


@lru_cache
def _sections(share: float) -> tuple[FloatArray, FloatArray]:
    """Second-order sections of the low-pass and their steady state (sections, 2) for a unit input.

    ``share`` is the cut-off over half the sampling rate.
    """
    sections = np.asarray(signal.butter(4, share, output="sos"))
    return sections, np.asarray(signal.sosfilt_zi(sections))


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Filtered motion of all joints at evenly spaced times.

    Attributes:
        t: Times, (n,), s.
        q: Angles, (n, 6), rad.
        qd: Velocities, (n, 6), rad/s.
        qdd: Accelerations, (n, 6), rad/s².
        temperature: Temperatures, (n, 6), °C.
        judged: Marks samples at which a joint moves, (n, 6).
        low_pass: The filter; None for a record that was not prepared.
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
        """Filter columns (n, …) as the currents were filtered."""
        return columns if self.low_pass is None else self.low_pass(columns)

    def slowly(self, columns: FloatArray, *, factor: float = 3.0) -> FloatArray:
        """Filter columns (n, …) at 1/``factor`` of the cut-off, to be differentiated twice."""
        if self.low_pass is None:
            return columns
        return LowPass(self.low_pass.cut_off / factor, self.low_pass.period)(columns)


@dataclass(frozen=True, slots=True)
class PreparedRecord(Record):
    """A filtered and thinned out record, with the full motion of each recording."""

    motions: tuple[Motion, ...] = field(default=(), compare=False)

    @property
    def motion(self) -> Motion | None:
        """The motion of a single recording; None for several."""
        return self.motions[0] if len(self.motions) == 1 else None

    def part(self, first: int, last: int) -> PreparedRecord:
        """Cut out the samples first … last − 1, with the motions of their recordings."""
        # not super(): a dataclass with slots is a new class, which super() does not find
        motions = tuple(self.motions[k] for k in self.within(first, last)) if self.motions else ()
        selected = Record.part(self, first, last)
        assert isinstance(selected, PreparedRecord)
        return replace(selected, motions=motions)

    def followed_by(self, others: Sequence[Record]) -> PreparedRecord:
        """Append other prepared records."""
        records = [record for record in (self, *others) if isinstance(record, PreparedRecord)]
        combined = Record.followed_by(self, others)
        assert isinstance(combined, PreparedRecord)
        return replace(combined, motions=tuple(motion for record in records for motion in record.motions))

    @property
    def autocorrelation(self) -> tuple[float, ...]:
        """Autocorrelation of filtered white noise at lags of 0 to 3 rows."""
        low_pass = self.motions[0].low_pass if self.motions else None
        if low_pass is None or len(self) < MIN_SAMPLES:
            return WHITE_NOISE_AUTOCORRELATION
        every = int(np.median(np.diff(self.places)))
        correlation = low_pass.autocovariance(3 * every + 1)
        return tuple((correlation[::every] / correlation[0]).tolist())

    @property
    def places(self) -> np.ndarray:
        """Index of each row in the motion, (n,)."""
        return np.asarray(np.rint(self.auxiliary[PLACE]), dtype=np.int64)


def cut_off_of(record: Record | None) -> float:
    """Choose the cut-off of a record by the bandwidth of its velocities.

    Args:
        record: The record; None for the lowest cut-off.

    Returns:
        The highest cut-off of its recordings, Hz.
    """
    return MIN_CUT_OFF if record is None else max(_cut_off(recording) for recording in record.recordings())


def _cut_off(
    record: Record,
    *,
    power_share: float = 0.99,
    bandwidths: float = 10.0,
    max_sampling_rate_share: float = 1.0 / 3.0,
) -> float:
    """Cut-off of one recording, Hz: a multiple of the bandwidth with ``power_share`` of the power."""
    if len(record) < MIN_SAMPLES:
        return MIN_CUT_OFF
    period, joints = record.period, record.outputs.shape[1]
    grid = np.arange(record.t[0], record.t[-1], period)
    velocities = [np.interp(grid, record.t, c) for c in record.inputs[:, joints : 2 * joints].T]
    power = np.sum([np.abs(np.fft.rfft(v * np.hanning(len(v)))) ** 2 for v in velocities], axis=0)
    frequency = np.fft.rfftfreq(len(grid), period)
    share = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    edge = float(frequency[min(int(np.searchsorted(share, power_share)), len(frequency) - 1)])
    return float(np.clip(bandwidths * edge, MIN_CUT_OFF, max(max_sampling_rate_share / period, MIN_CUT_OFF)))


def unfiltered_motion(record: Record) -> Motion:
    """The motion of a record that was not prepared: no filter, accelerations by differences."""
    joints = record.outputs.shape[1]
    q, qd = record.inputs[:, :joints], record.inputs[:, joints : 2 * joints]
    qdd = np.gradient(qd, record.t, axis=0)
    return Motion(record.t, q, qd, qdd, _warmth(record), np.ones(q.shape, dtype=bool), None)


def prepare_record(record: Record, cut_off: float) -> PreparedRecord:
    """Filter a recording and keep the rows that can be compared.

    Args:
        record: A single recording.
        cut_off: Cut-off of the low-pass, Hz.

    Returns:
        The prepared record.

    Raises:
        RecordingError: The recording is too short, or there is too little motion.
    """
    period, joints = record.period, record.outputs.shape[1]
    grid = record.t[0] + period * np.arange(int((record.t[-1] - record.t[0]) / period + 1e-6) + 1)
    low_pass = LowPass(min(cut_off, 0.45 / period), period)
    if len(grid) < MIN_SAMPLES:
        raise RecordingError(
            f"too short for inverse dynamics: {len(grid)} samples, at least {MIN_SAMPLES} needed"
        )
    inputs, outputs = _resample(grid, record.t, record.inputs), _resample(grid, record.t, record.outputs)
    auxiliary = {name: np.interp(grid, record.t, x) for name, x in record.auxiliary.items()}
    even = replace(record, t=grid, inputs=inputs, outputs=outputs, auxiliary=auxiliary)
    q, qd = low_pass(inputs[:, :joints]), low_pass(inputs[:, joints : 2 * joints])
    qdd = np.gradient(qd, period, axis=0)
    moving = _erode(np.abs(qd) > REST_VELOCITY, low_pass.reach)
    motion = Motion(grid, q, qd, qdd, low_pass(_warmth(even)), moving, low_pass)
    rows = _kept_rows(record.t, motion)
    if len(rows) < MIN_SAMPLES:
        raise RecordingError(
            f"too little motion for inverse dynamics: {len(rows)} samples are left where a joint moves "
            f"faster than {REST_VELOCITY:g} rad/s, at least {MIN_SAMPLES} are needed"
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
    """Samples that are kept: thinned out, away from ends and gaps, where at least one joint moves."""
    low_pass = motion.low_pass
    assert low_pass is not None
    every = max(1, round(1.0 / (ROWS_PER_CUT_OFF_PERIOD * low_pass.cut_off * low_pass.period)))
    after = np.clip(np.searchsorted(t, motion.t), 1, len(t) - 1)
    usable = _erode(
        (t[after] - t[after - 1] < MAX_GAP_IN_PERIODS * low_pass.period)[:, None], low_pass.reach
    )[:, 0]
    usable[: 3 * low_pass.reach] = usable[-3 * low_pass.reach :] = False
    keep = usable & motion.judged.any(axis=1)
    rows = np.arange(0, len(keep), every)
    return np.asarray(rows[keep[rows]])


def _erode(flags: np.ndarray, reach: int) -> np.ndarray:
    """Flags (n, k) that are set within ``reach`` samples on both sides too."""
    wrong = np.cumsum(np.vstack([np.zeros((1, flags.shape[1]), dtype=np.int64), ~flags]), axis=0)
    n = len(flags)
    low = np.maximum(np.arange(n) - reach, 0)
    high = np.minimum(np.arange(n) + reach + 1, n)
    return np.asarray(wrong[high] == wrong[low])


def _resample(grid: FloatArray, t: FloatArray, columns: FloatArray) -> FloatArray:
    """Interpolate columns at the times ``grid``."""
    return np.column_stack([np.interp(grid, t, column) for column in columns.T])


def temperatures(record: Record) -> FloatArray | None:
    """Joint temperatures of a record, (n, 6), °C; None if it has none."""
    names = [f"joint_temperatures_{j}" for j in range(record.outputs.shape[1])]
    if not all(name in record.auxiliary for name in names):
        return None
    return np.column_stack([record.auxiliary[name] for name in names])


def _warmth(record: Record) -> FloatArray:
    """Joint temperatures (n, 6), °C; zeros if there are none."""
    measured = temperatures(record)
    return np.zeros(record.outputs.shape) if measured is None else measured
