"""The samples of one topic in their order: copies dropped, late ones put in place, several runs kept apart.

A recorder writes the samples of a stream once and in order. Programs that merge or copy recordings need not:
a sample may stand in a file twice, behind later ones, or beside those of another run that bear the same
numbers. Numbers decide, for they are counted at the device; the host's clock may have been set.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from labhil.errors import RecordingError
from labhil.signals import Batch, IntArray, Stream

FEWEST = 40
"""Samples that a run has where numbers begin anew: no fit accepts fewer, and two runs that were shuffled into
one another, or one whose host's clock was set, fall into pieces of one or two samples."""

UNIX_TIMES = 946_684_800_000_000_000
"""ns; the year 2000. Stamps before it are no dates but times from 0."""


class MixedRunsError(ValueError):
    """Samples with the same numbers, shuffled so that nothing tells which belong together."""


@dataclass(frozen=True, slots=True)
class Run:
    """The samples of one run in order; ``copies`` were dropped, ``moved`` ones stood behind later ones."""

    batch: Batch
    copies: int = 0
    moved: int = 0


def separate_runs(channels: Sequence[Batch]) -> list[Run]:
    """Return the runs that the samples of one topic belong to, by their first times.

    Two channels are two runs, unless they share samples and make one sequence: then one is a copy of the
    other, or goes on where it ends.

    Args:
        channels: The samples of each channel of the topic, as they stand in the file; none is empty.

    Raises:
        MixedRunsError: One channel holds several runs that cannot be separated.
    """
    groups: list[Batch] = []
    for batch in channels:
        for place, group in enumerate(groups):
            joined = _concatenate([group, batch])
            if _continues(group, batch, joined):
                groups[place] = joined
                break
        else:
            groups.append(batch)
    runs = [run for group in groups for run in _order_runs(group)]
    # a stream may have no samples at all
    return sorted(runs, key=lambda run: int(run.batch.t_acq_ns.min(initial=np.iinfo(np.int64).max)))


def order_samples(seq: IntArray, t_acq_ns: IntArray, t_hw_ns: IntArray) -> list[IntArray]:
    """Return the places of the samples of each run, in order; no sample stands twice.

    Samples that count up as they stand are one run. So are those that count up by the host's time, and those
    with different numbers by which the device's clock goes forward (the host's was set). Else a run begins
    where the numbers go back, by the host's time or, where that does not tell, as they stand.

    Args:
        seq: Numbers, shape (n,).
        t_acq_ns: Times of the host, ns, shape (n,).
        t_hw_ns: Times of the device's clock, ns, shape (n,).

    Raises:
        MixedRunsError: Runs are shuffled into one another.
    """
    if _is_increasing(seq):
        return [np.arange(len(seq))]
    by_time = np.lexsort((seq, t_acq_ns))
    begins = np.flatnonzero(np.diff(seq[by_time]) <= 0) + 1
    if len(begins) == 0 or (seq == seq[0]).all():  # nobody counted in the latter case
        return [by_time]
    pieces = list(np.split(by_time, begins))
    by_number = np.argsort(seq, kind="stable")
    if _is_increasing(seq[by_number]) and _is_increasing(t_hw_ns[by_number]):
        # no number twice: the host's clock was set in one run, unless the pieces are long enough to be runs
        return pieces if min(map(len, pieces)) >= FEWEST else [by_number]
    as_they_stand = np.split(np.arange(len(seq)), np.flatnonzero(np.diff(seq) <= 0) + 1)
    for runs in (pieces, as_they_stand):
        if len(seq) >= FEWEST * len(runs):
            return runs
    same = len(seq) - len(np.unique(seq))
    raise MixedRunsError(
        f"expected samples whose numbers count up, found {same} of {len(seq)} with the number of another and "
        "other values: runs are shuffled into one channel, and nothing tells them apart; merge the "
        "recordings with a channel for each"
    )


def _order_runs(batch: Batch) -> list[Run]:
    if _is_increasing(batch.seq):
        return [Run(batch)]
    single = _take(batch, _first_of_each(batch))
    places = order_samples(single.seq, single.t_acq_ns, single.t_hw_ns)
    runs = [Run(_take(single, place), moved=count_late(single.seq[np.sort(place)])) for place in places]
    return [Run(runs[0].batch, len(batch) - len(single), runs[0].moved), *runs[1:]]


def count_late(seq: IntArray) -> int:
    """How many samples stand behind one with a larger number."""
    return int(np.count_nonzero(seq < np.maximum.accumulate(seq)))


def _is_increasing(numbers: IntArray) -> bool:
    return bool((np.diff(numbers) > 0).all())


def _continues(group: Batch, batch: Batch, joined: Batch) -> bool:
    """Whether two channels share samples, and make one run together."""
    if not np.isin(_keys(batch), _keys(group)).any():
        return False
    single = _take(joined, _first_of_each(joined))
    try:
        return len(order_samples(single.seq, single.t_acq_ns, single.t_hw_ns)) == 1
    except MixedRunsError:
        return False


def _first_of_each(batch: Batch) -> IntArray:
    """Where different samples stand first."""
    places: IntArray = np.sort(np.unique(_keys(batch), return_index=True)[1])
    return places


def _keys(batch: Batch) -> np.ndarray:
    """Each sample's stamps and values as one word of bytes: equal only for exact copies."""
    values = np.ascontiguousarray(batch.values).view(np.int64)
    rows = np.column_stack([batch.seq, batch.t_acq_ns, batch.t_hw_ns, values.reshape(len(batch), -1)])
    return np.ascontiguousarray(rows).view(np.dtype((np.void, rows.shape[1] * rows.itemsize)))[:, 0]


def _take(batch: Batch, places: IntArray) -> Batch:
    return Batch(batch.seq[places], batch.t_acq_ns[places], batch.t_hw_ns[places], batch.values[places])


def _concatenate(batches: Sequence[Batch]) -> Batch:
    return Batch.joined(batches, batches[0].values.shape[1])


class RunOfStream(Protocol):
    """What :func:`choose_run` needs to know of the samples of one run of a stream."""

    @property
    def device(self) -> str:
        """Whose stream it is."""

    @property
    def stream(self) -> Stream:
        """Its declaration."""

    @property
    def t_acq_ns(self) -> IntArray:
        """Times of the host, ns, shape (n,)."""


OneRun = TypeVar("OneRun", bound=RunOfStream)


def choose_run(path: Path, topics: Sequence[Sequence[OneRun]], run: int | None) -> tuple[list[OneRun], range]:
    """Return the streams of one run of a file, and the times (ns) whose events belong to it.

    Args:
        path: The file, for messages.
        topics: The runs of each topic, by time; a topic with one has it in every run.
        run: Which one, from 1; topics with fewer are not in it.

    Raises:
        RecordingError: A topic has several runs, and none is chosen.
    """
    everything = range(-(2**63), 2**64)
    several = [runs for runs in topics if len(runs) > 1]
    if not several:
        return [runs[0] for runs in topics], everything
    if run is None:
        runs = several[0]
        topic = f"/{runs[0].device}/{runs[0].stream.name}"
        descriptions = "; ".join(f"{k}: {_describe(stream.t_acq_ns)}" for k, stream in enumerate(runs, 1))
        raise RecordingError(
            f"{path}: expected one run of {topic}, found {len(runs)}: {descriptions}; choose one with --run N"
        )
    most = max(map(len, several))
    if not 1 <= run <= most:
        raise RecordingError(f"{path}: --run {run}: expected a number from 1 to {most}")
    begins = [int(stream.t_acq_ns.min()) for stream in max(several, key=len)]
    begin = begins[run - 1] if run > 1 else everything.start
    end = begins[run] if run < most else everything.stop
    chosen = [runs[run - 1 : run] if len(runs) > 1 else runs for runs in topics]
    streams = [stream for runs in chosen for stream in runs]
    return streams, range(begin, end)


def _describe(t_acq_ns: IntArray) -> str:
    """How many samples there are, from when and how long, for messages; ``t_acq_ns`` (n,) is not empty."""
    first, last = int(t_acq_ns.min()), int(t_acq_ns.max())
    begin = f"{first * 1e-9:.6g} s"
    if first >= UNIX_TIMES:
        begin = f"{datetime.fromtimestamp(first * 1e-9, UTC):%Y-%m-%d %H:%M:%S} UTC"
    return f"{len(t_acq_ns)} samples, {(last - first) * 1e-9:.6g} s from {begin}"
