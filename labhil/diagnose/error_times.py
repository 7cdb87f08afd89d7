"""When a mismatch occurs: the windows, and the recordings, that hold most of an error reduction."""

from __future__ import annotations

import numpy as np

from labhil.identify.score import Score
from labhil.physics.model import Metric
from labhil.physics.record import Record
from labhil.signals import FloatArray


def error_reduction(before: Score, after: Score) -> FloatArray:
    """Reduction of the squared errors of each scored sample, in squared noise floors, (N, c)."""
    floors = np.array([channel.noise_floor for channel in after.channels])
    return np.asarray((before.errors / floors) ** 2 - (after.errors / floors) ** 2)


def times(
    before: Score, after: Score, record: Record, most: int = 5, n_blocks: int = 12
) -> tuple[tuple[tuple[float, float], ...], tuple[int, ...]]:
    """List the ``most`` scored windows that together hold half of the error reduction, worst first.

    A recording of a single window is cut into ``n_blocks``. Returned are begin and end (s) of each, and,
    where there are several recordings, the number of each one's recording.
    """
    excess = error_reduction(before, after).sum(axis=1)
    pieces = [np.flatnonzero(before.window == w) for w in np.unique(before.window)]
    if len(pieces) == 1 or after.metric is Metric.INVERSE_DYNAMICS:
        blocks = max(n_blocks // len(pieces), 1)
        pieces = [block for piece in pieces for block in np.array_split(piece, blocks)]
    sums = np.array([excess[piece].sum() for piece in pieces])
    order = np.argsort(sums)[::-1]
    spans, numbers, held = [], list[int](), 0.0
    for i in order[:most]:
        if sums[i] <= 0 or held > 0.5 * sums[sums > 0].sum():
            break
        rows = before.rows[pieces[i]]
        number, begin = record.own_time(int(rows[0]))
        spans.append((begin, record.own_time(int(rows[-1]))[1]))
        numbers.append(number)
        held += float(sums[i])
    return tuple(spans), tuple(numbers) if len(record.begins) > 1 else ()


def recording_shares(before: Score, after: Score) -> str:
    """A sentence with the share of each of several recordings in the error reduction; "" of one recording."""
    excess = error_reduction(before, after).sum(axis=1)
    sums = np.array([max(float(excess[recording.places].sum()), 0.0) for recording in after.recordings])
    if not np.any(sums):
        return ""
    shares = 100.0 * sums / sums.sum()
    parts = [f"{s:.0f} % in recording {r.recording}" for s, r in zip(shares, after.recordings, strict=True)]
    return f" Of the excess error {', '.join(parts)}."
