"""Windows of a record for fits and for scores, the training/test split, and the noise of the channels.

A window is a section of a recording that begins in an initial state of its own. The estimation of these
states is in window_states.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from labhil.errors import RecordingError
from labhil.identify.quantiser import converter_step, held_samples, uneven_step
from labhil.physics.joining import join_records
from labhil.physics.model import Metric, Model
from labhil.physics.record import Record, Windows
from labhil.signals import FloatArray, IntArray

FEWEST_SAMPLES = 20
"""Smallest number of samples of a recording, and of the lead-in of a scored window."""

MIN_HOLE_IN_PERIODS = 10.0
"""Gap between samples, in median sampling periods, from which no window spans it: the input in it is unknown.

The input's hold bridges shorter gaps. Windows that end at every lost sample would all be short.
"""

FEWEST_SAMPLES_IN_WINDOW = 8
"""Smallest number of samples of a fitted window, whose initial state takes a few degrees of freedom."""


def fit_windows(record: Record, length: float) -> Windows:
    """Cut each recording of a record into consecutive windows of equal length.

    Args:
        record: one or several recordings.
        length: approximate length of a window in s.

    Returns:
        The windows. None spans a hole, unless a recording has no section of 20 samples between its holes.

    Raises:
        RecordingError: A recording has fewer than 20 samples.
    """
    spans = []
    for before, recording, label in _labelled_recordings(record):
        if len(recording) < FEWEST_SAMPLES:
            raise RecordingError(
                f"{label}too short: {len(recording)} samples, at least {FEWEST_SAMPLES} are needed"
            )
        for first, last in _sections(recording):
            cut = recording.part(first, last)
            spans += [(before + first + a, before + first + b) for a, b in _equal_windows(cut, length)]
    return Windows.of(spans)


def _equal_windows(record: Record, length: float) -> list[tuple[int, int]]:
    """Rows (first, after last) of equal windows of about ``length`` s of a recording."""
    n, duration = len(record), record.t[-1] - record.t[0]
    count = max(1, round(duration / length))
    count = max(1, min(count, n // FEWEST_SAMPLES_IN_WINDOW))
    edges = np.searchsorted(record.t, record.t[0] + duration * np.arange(count + 1) / count)
    edges[-1] = n
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a > 1]


def _labelled_recordings(record: Record) -> Iterator[tuple[int, Record, str]]:
    """Each recording with the number of samples before it, and how a message about it begins."""
    several = len(record.begins) > 1
    for begin, recording in zip(record.begins, record.recordings(), strict=True):
        yield begin.row, recording, f"recording {begin.number}: " if several else ""


def _sections(record: Record) -> list[tuple[int, int]]:
    """Rows (first, after last) of the sections between the holes of one recording.

    Sections of a few samples are left out. A recording without any other section counts as one.
    """
    step = np.diff(record.t)
    ends = np.flatnonzero(step > MIN_HOLE_IN_PERIODS * np.median(step)) + 1
    edges = np.r_[0, ends, len(record)]
    sections = [(int(a), int(b)) for a, b in pairwise(edges) if b - a >= FEWEST_SAMPLES]
    return sections or [(0, len(record))]


@dataclass(frozen=True, slots=True)
class ScoredWindows:
    """Windows with a lead-in, on which the initial state is estimated, and a scored part.

    Attributes:
        lead: the lead-ins.
        whole: lead-ins with the scored parts.
        scored: (N,), whether a row of ``whole`` is scored.
        horizon: length of the scored parts in s.
    """

    lead: Windows
    whole: Windows
    scored: np.ndarray
    horizon: float


def scored_windows(record: Record, horizon: float) -> ScoredWindows:
    """Tile each recording with scored parts, each after a lead-in of half a horizon.

    The lead-in has at least 20 samples, or as many as there are. The last scored part of a recording may be
    shorter, down to half a horizon.

    Args:
        record: one or several recordings.
        horizon: length of a scored part in s.

    Raises:
        RecordingError: A recording is too short for one window.
    """
    tiles = [
        before + _tiles_between_holes(recording, horizon, label)
        for before, recording, label in _labelled_recordings(record)
    ]
    first, middle, last = np.concatenate(tiles, axis=1)
    lead_windows = Windows.of(list(zip(first.tolist(), middle.tolist(), strict=True)))
    whole = Windows.of(list(zip(first.tolist(), last.tolist(), strict=True)))
    return ScoredWindows(lead_windows, whole, whole.rows >= middle[whole.owner], horizon)


def _tiles_between_holes(record: Record, horizon: float, label: str) -> IntArray:
    """Tiles (3, w) between the holes of one recording, or across them where none fits between."""
    by_section = [first + _tiles(record.part(first, last), horizon) for first, last in _sections(record)]
    tiles = np.concatenate(by_section, axis=1)
    if not tiles.size:
        tiles = _tiles(record, horizon)
    if not tiles.size:
        duration = record.t[-1] - record.t[0] if len(record) else 0.0
        lead = max(0.5 * horizon, FEWEST_SAMPLES * record.period)
        raise RecordingError(
            f"{label}too short to score: {duration:.3g} s, one window needs {lead + 0.5 * horizon:.3g} s "
            f"(lead-in {lead:.3g} s and half a horizon); a shorter [metric] horizon may do"
        )
    return tiles


def _tiles(record: Record, horizon: float) -> IntArray:
    """First row, first scored row and row after the last of each window of one recording, (3, w)."""
    lead = max(0.5 * horizon, FEWEST_SAMPLES * record.period)
    starts = np.arange(record.t[0] + lead, record.t[-1] - 0.5 * horizon, horizon)
    if not len(starts):
        return np.empty((3, 0), dtype=np.int64)
    edges = np.searchsorted(record.t, np.append(starts, starts[-1] + horizon))
    middle, last = edges[:-1], edges[1:]
    first = np.maximum(np.minimum(np.searchsorted(record.t, starts - lead), middle - FEWEST_SAMPLES), 0)
    return np.array([first, middle, last])


def whole_recordings(record: Record) -> ScoredWindows:
    """Every recording as one scored window without a lead-in: inverse dynamics has no initial state."""
    recordings = Windows.of(record.spans)
    return ScoredWindows(recordings, recordings, np.ones(len(record), dtype=bool), record.longest)


def split(record: Record, share: float, gap: float) -> tuple[Record, Record]:
    """Split each recording into training data and, after a gap, held-out data at its end.

    Args:
        record: one or several recordings.
        share: fraction of the time of each recording to hold out; holes do not count.
        gap: time in s between both parts, which belongs to none.

    Returns:
        The training data and the held-out data.
    """
    parts = [_split_one(recording, share, gap) for recording in record.recordings()]
    return join_records([train for train, _ in parts]), join_records([held_out for _, held_out in parts])


def _split_one(record: Record, share: float, gap: float) -> tuple[Record, Record]:
    t = _without_holes(record.t)
    start = t[-1] - share * (t[-1] - t[0])
    cut = int(np.searchsorted(t, start - gap))
    return record.part(0, cut), record.part(int(np.searchsorted(t, start)), len(record))


def _without_holes(t: FloatArray) -> FloatArray:
    """Times (n,) with the median step in the place of each hole."""
    step = np.diff(t)
    long = step > MIN_HOLE_IN_PERIODS * np.median(step) if len(step) else step > 0.0
    if not long.any():
        return t
    return np.asarray(t[0] + np.r_[0.0, np.cumsum(np.where(long, np.median(step), step))])


def noise_of(
    record: Record, *, min_moving_groups: int = 32, outlier_limit_in_deviations: float = 8.0
) -> FloatArray:
    """Estimate the measurement noise of each channel from third differences of the recording.

    Third differences (divided differences at uneven stamps) cancel any motion that is quadratic over four
    samples. Their weights have unit norm, so white noise keeps its variance. A robust scale excludes events.
    A quantised channel that the noise does not dither has at least the rounding variance step²/12, also with
    uneven steps. Where a channel is held at one value for long (a part at rest, the end of a range), only the
    other samples count, and ``record.least_noise`` is the lower limit from the whole recording. A controller
    that turns noise into motion within four samples makes the estimate up to 15 % too small.

    Args:
        record: one or several recordings of N samples.
        min_moving_groups: smallest number of moving groups of four samples from which the noise of a held
            channel is estimated; the error is then below 15 %.
        outlier_limit_in_deviations: differences beyond this many robust standard deviations are events.

    Returns:
        Standard deviations (channels,), in the channels' units.
    """
    sigmas = []
    rows, third = _third_differences(record)
    for j, column in enumerate(record.outputs.T):
        differences, step = third(column), converter_step(column)
        # an evenly quantised channel holds its value also in motion, and its noise is the rounding
        if step == 0.0:
            step = uneven_step(column)
            held = held_samples(column)
            moving = ~held[rows].all(axis=1)
            enough = held.any() and moving.sum() >= min_moving_groups
            differences = differences[moving] if enough else differences
        limit = outlier_limit_in_deviations * _robust_scale(differences)
        spread = float(np.sqrt(np.mean(np.square(differences[np.abs(differences) <= limit]))))
        least = record.least_noise[j] if record.least_noise else 0.0
        sigmas.append(max(spread, step / np.sqrt(12.0), least, 1e-12))
    return np.array(sigmas)


def with_least_noise(record: Record) -> Record:
    """Store the noise of channels that are held for long in the record, so that parts at rest keep it.

    Other channels get zero: there every part of the record shows its noise.
    """
    rests = np.array([bool(held_samples(column).any()) for column in record.outputs.T])
    if not rests.any() or len(record) < FEWEST_SAMPLES or not np.isfinite(record.outputs).all():
        return record
    rounding = np.array([converter_step(column) for column in record.outputs.T]) / np.sqrt(12.0)
    least = np.where(rounding > 0.0, rounding, noise_of(record))
    return replace(record, least_noise=tuple(np.where(rests, least, 0.0).tolist()))


def _third_differences(record: Record) -> tuple[IntArray, Callable[[FloatArray], FloatArray]]:
    """Rows (k, 4) of all groups of four neighbours, and the filter of a channel (N,) to differences (k,).

    The weights of the filter have unit norm.
    """
    first = np.concatenate([np.arange(a, b - 3) for a, b in record.spans])
    rows = first[:, None] + np.arange(4)
    t = record.t[rows]
    # times that do not increase are a fault of the data: such samples count as evenly spaced
    t = np.where((np.diff(t, axis=1) > 0.0).all(axis=1, keepdims=True), t, np.arange(4.0))
    weights = 1.0 / np.prod(t[:, :, None] - t[:, None, :] + np.eye(4), axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return rows, lambda column: np.asarray(np.sum(weights * column[rows], axis=1))


def with_noise_scales(model: Model, record: Record) -> Record:
    """Store the noise scale of each of several recordings, so that noisier ones have less weight.

    A single recording, and data of inverse dynamics, whose filtered noise differences do not show, stay as
    they are.
    """
    if len(record.begins) == 1 or model.metric is Metric.INVERSE_DYNAMICS:
        return record
    noise = noise_of(record)
    scales = [tuple((noise_of(recording) / noise).tolist()) for recording in record.recordings()]
    return replace(
        record,
        begins=tuple(replace(b, noise_scale=scale) for b, scale in zip(record.begins, scales, strict=True)),
    )


def noise_at(record: Record, rows: IntArray, sigma: FloatArray) -> FloatArray:
    """Noise of the channels at some rows of a record, (N, channels), or ``sigma`` where all are equal."""
    if not any(begin.noise_scale for begin in record.begins):
        return sigma
    by_recording = np.array([sigma * (begin.noise_scale or 1.0) for begin in record.begins])
    return np.asarray(by_recording[np.searchsorted([b.row for b in record.begins], rows, side="right") - 1])


def _robust_scale(x: FloatArray) -> float:
    """Standard deviation (1.4826 times the median absolute value) of values around zero."""
    median = float(np.median(np.abs(x)))
    return 1.4826 * median if median > 0 else float(np.std(x)) + 1e-300
