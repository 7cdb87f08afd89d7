"""How a record is cut into windows: to fit on, and to score on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from labhil.errors import RecordingError
from labhil.identify.quantiser import converter_step, held_samples, uneven_step
from labhil.physics.joining import join_records
from labhil.physics.model import Metric, Model, Record, Windows
from labhil.signals import FloatArray, IntArray

FEWEST_SAMPLES = 20
"""In a record, and in the lead-in of a scored window."""

HOLE = 10.0
"""Usual steps of time from which no window goes on over a hole: what drove the rig in it is not known.

Shorter ones are bridged as the input's hold says: windows that end at each lost sample would all be short.
"""

FEWEST_IN_WINDOW = 8
"""In a window that is fitted: its own state costs a few."""

FEWEST_MOVING = 32
"""Groups of four samples that move, from which the noise is read there: its error is then under 15 %."""


def fit_windows(record: Record, length: float) -> Windows:
    """Cut each recording of a record into equal windows of about ``length`` s, end to end.

    Raises RecordingError when a recording is too short for one window of 20 samples.
    """
    spans = []
    for before, recording, label in _labelled_recordings(record):
        if len(recording) < FEWEST_SAMPLES:
            raise RecordingError(
                f"{label}too short: {len(recording)} samples, at least {FEWEST_SAMPLES} are needed"
            )
        for first, last in _stretches(recording):
            cut = recording.part(first, last)
            spans += [(before + first + a, before + first + b) for a, b in _equal_windows(cut, length)]
    return Windows.of(spans)


def _equal_windows(record: Record, length: float) -> list[tuple[int, int]]:
    """Equal windows of about ``length`` s of a recording, (first, last) each."""
    n, duration = len(record), record.t[-1] - record.t[0]
    count = max(1, round(duration / length))
    count = max(1, min(count, n // FEWEST_IN_WINDOW))
    edges = np.searchsorted(record.t, record.t[0] + duration * np.arange(count + 1) / count)
    edges[-1] = n
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a > 1]


def _labelled_recordings(record: Record) -> Iterator[tuple[int, Record, str]]:
    """Each recording with the number of samples before it, and how a message about it begins."""
    several = len(record.begins) > 1
    for begin, recording in zip(record.begins, record.recordings(), strict=True):
        yield begin.row, recording, f"recording {begin.number}: " if several else ""


def _stretches(record: Record) -> list[tuple[int, int]]:
    """First sample, and the one after the last, of what lies between the holes of one recording.

    Those of a few samples are left out; the whole recording where it has no other.
    """
    step = np.diff(record.t)
    ends = np.flatnonzero(step > HOLE * np.median(step)) + 1
    edges = np.r_[0, ends, len(record)]
    stretches = [(int(a), int(b)) for a, b in pairwise(edges) if b - a >= FEWEST_SAMPLES]
    return stretches or [(0, len(record))]


@dataclass(frozen=True, slots=True)
class ScoredWindows:
    """Windows with a lead-in, where a model finds its initial state, and a scored rest.

    ``lead`` covers the lead-ins alone, ``whole`` lead-in and scored part; ``scored`` (N,) marks the
    rows of ``whole`` that count.
    """

    lead: Windows
    whole: Windows
    scored: np.ndarray
    horizon: float


def scored_windows(record: Record, horizon: float) -> ScoredWindows:
    """Tile each recording with scored stretches of ``horizon`` s, each after a lead-in of half of that.

    The lead-in has at least 20 samples, or as many as there are. The last stretch may be shorter,
    down to half a horizon. Raises RecordingError when not even one fits into a recording.
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
    """The tiles between the holes of one recording, (3, w), or across them where none fits between."""
    by_stretch = [first + _tiles(record.part(first, last), horizon) for first, last in _stretches(record)]
    tiles = np.concatenate(by_stretch, axis=1)
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
    """First sample, first scored one and the one after the last of each window of one recording, (3, w)."""
    lead = max(0.5 * horizon, FEWEST_SAMPLES * record.period)
    starts = np.arange(record.t[0] + lead, record.t[-1] - 0.5 * horizon, horizon)
    if not len(starts):
        return np.empty((3, 0), dtype=np.int64)
    edges = np.searchsorted(record.t, np.append(starts, starts[-1] + horizon))
    middle, last = edges[:-1], edges[1:]
    first = np.maximum(np.minimum(np.searchsorted(record.t, starts - lead), middle - FEWEST_SAMPLES), 0)
    return np.array([first, middle, last])


def all_of(record: Record) -> ScoredWindows:
    """Each whole recording as one scored stretch without a lead-in: for inverse dynamics, without a state."""
    recordings = Windows.of(record.spans)
    return ScoredWindows(recordings, recordings, np.ones(len(record), dtype=bool), record.longest)


def split(record: Record, share: float, gap: float) -> tuple[Record, Record]:
    """Hold out the last ``share`` of each recording, contiguous, after a gap of ``gap`` s.

    The time of holes does not count.
    """
    parts = [_split(recording, share, gap) for recording in record.recordings()]
    return join_records([learn for learn, _ in parts]), join_records([held_out for _, held_out in parts])


def _split(record: Record, share: float, gap: float) -> tuple[Record, Record]:
    t = _without_holes(record.t)
    start = t[-1] - share * (t[-1] - t[0])
    cut = int(np.searchsorted(t, start - gap))
    return record.part(0, cut), record.part(int(np.searchsorted(t, start)), len(record))


def _without_holes(t: FloatArray) -> FloatArray:
    """Times (n,) with a usual step in the place of each hole."""
    step = np.diff(t)
    long = step > HOLE * np.median(step) if len(step) else step > 0.0
    if not long.any():
        return t
    return np.asarray(t[0] + np.r_[0.0, np.cumsum(np.where(long, np.median(step), step))])


def noise_of(record: Record) -> FloatArray:
    """Standard deviation of the measurement noise of each channel, from the recording alone, (channels,).

    Third differences, divided where stamps are uneven, leave nothing of a motion that is smooth over four
    samples; their weights are of length one, so that white noise keeps its variance. A robust scale keeps
    events out of it. A channel in steps (an ADC that the noise does not dither) has at least the variance of
    rounding, step²/12, also where its steps are uneven. Where a channel is held at one value for long (a part
    at rest, the end of a range) its noise is that of all else; ``record.least_noise`` is what the whole
    recording showed. A controller that reacts to noise with motion within four samples makes it look a
    little (under 15 %) too small.
    """
    sigmas = []
    rows, third = _third_differences(record)
    for j, column in enumerate(record.outputs.T):
        differences, step = third(column), converter_step(column)
        # what is read in even steps is held by them as well as by rest, and has their rounding for its noise
        if step == 0.0:
            step = uneven_step(column)
            held = held_samples(column)
            moving = ~held[rows].all(axis=1)
            differences = differences[moving] if held.any() and moving.sum() >= FEWEST_MOVING else differences
        spread = float(
            np.sqrt(np.mean(np.square(differences[np.abs(differences) <= 8.0 * _robust_scale(differences)])))
        )
        least = record.least_noise[j] if record.least_noise else 0.0
        sigmas.append(max(spread, step / np.sqrt(12.0), least, 1e-12))
    return np.array(sigmas)


def with_least_noise(record: Record) -> Record:
    """The record with the noise of its channels that are held for long, so that a part at rest knows it too.

    Other channels state none: there every part shows its own.
    """
    rests = np.array([bool(held_samples(column).any()) for column in record.outputs.T])
    if not rests.any() or len(record) < FEWEST_SAMPLES or not np.isfinite(record.outputs).all():
        return record
    rounding = np.array([converter_step(column) for column in record.outputs.T]) / np.sqrt(12.0)
    least = np.where(rounding > 0.0, rounding, noise_of(record))
    return replace(record, least_noise=tuple(np.where(rests, least, 0.0).tolist()))


def _third_differences(record: Record) -> tuple[IntArray, Callable[[FloatArray], FloatArray]]:
    """Groups of four neighbours (k, 4), and what takes of a channel (N,) every quadratic over each, (k,).

    Variances are kept.
    """
    first = np.concatenate([np.arange(a, b - 3) for a, b in record.spans])
    rows = first[:, None] + np.arange(4)
    t = record.t[rows]
    # time that stands or goes back is a fault of the data: such samples are taken as evenly spaced
    t = np.where((np.diff(t, axis=1) > 0.0).all(axis=1, keepdims=True), t, np.arange(4.0))
    weights = 1.0 / np.prod(t[:, :, None] - t[:, None, :] + np.eye(4), axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return rows, lambda column: np.asarray(np.sum(weights * column[rows], axis=1))


def with_noise_scales(model: Model, record: Record) -> Record:
    """Several recordings with the noise of each, so that a loud one has less weight; a single one as it is.

    What a filter leaves of the noise, as of inverse dynamics, is not read from differences.
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
    """Noise of the channels at some rows of a record, (N, channels), or ``sigma`` itself where it is one."""
    if not any(begin.noise_scale for begin in record.begins):
        return sigma
    by_recording = np.array([sigma * (begin.noise_scale or 1.0) for begin in record.begins])
    return np.asarray(by_recording[np.searchsorted([b.row for b in record.begins], rows, side="right") - 1])


def _robust_scale(x: FloatArray) -> float:
    centre = float(np.median(np.abs(x)))
    return 1.4826 * centre if centre > 0 else float(np.std(x)) + 1e-300
