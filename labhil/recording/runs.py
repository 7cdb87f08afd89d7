"""Separation of the samples of a topic into runs, in order and without copies.

A recorder writes each sample once and in order. Programs that merge or copy recordings may repeat samples,
write them behind later ones, or mix runs with equal sequence numbers. The device counts these numbers, so
they decide; the host's clock may have been set.
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

MIN_UNIX_TIME = 946_684_800_000_000_000
"""Unix time of the year 2000, ns. Smaller stamps are times from 0."""


class MixedRunsError(ValueError):
    """Mixed samples of several runs that cannot be separated."""


@dataclass(frozen=True, slots=True)
class Run:
    """Samples of a run in order, the number of dropped copies, and of samples that were behind later ones."""

    batch: Batch
    copies: int = 0
    moved: int = 0


def separate_runs(channels: Sequence[Batch]) -> list[Run]:
    """Separate the samples of a topic into runs.

    Two channels are two runs unless they share samples and form one sequence: one is then a copy of the
    other, or its continuation.

    Args:
        channels: samples of each channel of the topic, in the order of the file.

    Returns:
        The runs by their first times.

    Raises:
        MixedRunsError: A channel contains several runs that cannot be separated.
    """
    groups: list[Batch] = []
    for batch in channels:
        for index, group in enumerate(groups):
            joined = _concatenate([group, batch])
            if _are_one_run(group, batch, joined):
                groups[index] = joined
                break
        else:
            groups.append(batch)
    runs = [run for group in groups for run in _order_runs(group)]
    # a stream may have no samples at all
    return sorted(runs, key=lambda run: int(run.batch.t_acq_ns.min(initial=np.iinfo(np.int64).max)))


def order_samples(
    seq: IntArray, t_acq_ns: IntArray, t_hw_ns: IntArray, *, min_run_samples: int = 40
) -> list[IntArray]:
    """Order the samples of a channel, and separate its runs.

    Samples are one run if their numbers increase in the order of the file or by the host's time, or if the
    device's clock increases with their unique numbers (the host's clock was set). Otherwise a run begins
    where the numbers decrease, by the host's time or, if that is ambiguous, in the order of the file.

    Args:
        seq: sequence numbers, (n,).
        t_acq_ns: the host's clock, (n,).
        t_hw_ns: the device's clock, (n,).
        min_run_samples: smallest number of samples of a run where numbers restart. No fit accepts fewer.
            Mixed runs, or a run during which the host's clock was set, yield parts of one or two.

    Returns:
        Indices of the samples of each run, in order.

    Raises:
        MixedRunsError: Runs are mixed and cannot be separated.
    """
    if _is_increasing(seq):
        return [np.arange(len(seq))]
    by_time = np.lexsort((seq, t_acq_ns))
    begins = np.flatnonzero(np.diff(seq[by_time]) <= 0) + 1
    if len(begins) == 0 or (seq == seq[0]).all():  # without numbers all are equal
        return [by_time]
    pieces = list(np.split(by_time, begins))
    by_number = np.argsort(seq, kind="stable")
    if _is_increasing(seq[by_number]) and _is_increasing(t_hw_ns[by_number]):
        # unique numbers: the host's clock was set in one run, unless the parts are long enough to be runs
        return pieces if min(map(len, pieces)) >= min_run_samples else [by_number]
    in_file_order = np.split(np.arange(len(seq)), np.flatnonzero(np.diff(seq) <= 0) + 1)
    for runs in (pieces, in_file_order):
        if len(seq) >= min_run_samples * len(runs):
            return runs
    n_repeated = len(seq) - len(np.unique(seq))
    raise MixedRunsError(
        f"expected samples whose numbers count up, found {n_repeated} of {len(seq)} with the number of "
        "another and other values: runs are shuffled into one channel, and nothing tells them apart; merge "
        "the recordings with a channel for each"
    )


def _order_runs(batch: Batch) -> list[Run]:
    if _is_increasing(batch.seq):
        return [Run(batch)]
    single = _select(batch, _first_copies(batch))
    indices = order_samples(single.seq, single.t_acq_ns, single.t_hw_ns)
    runs = [Run(_select(single, index), moved=count_late(single.seq[np.sort(index)])) for index in indices]
    return [Run(runs[0].batch, len(batch) - len(single), runs[0].moved), *runs[1:]]


def count_late(seq: IntArray) -> int:
    """Number of samples behind one with a larger sequence number."""
    return int(np.count_nonzero(seq < np.maximum.accumulate(seq)))


def _is_increasing(numbers: IntArray) -> bool:
    return bool((np.diff(numbers) > 0).all())


def _are_one_run(group: Batch, batch: Batch, joined: Batch) -> bool:
    """Whether two channels share samples and form one run."""
    if not np.isin(_sample_keys(batch), _sample_keys(group)).any():
        return False
    single = _select(joined, _first_copies(joined))
    try:
        return len(order_samples(single.seq, single.t_acq_ns, single.t_hw_ns)) == 1
    except MixedRunsError:
        return False


def _first_copies(batch: Batch) -> IntArray:
    """Indices of samples without later copies."""
    indices: IntArray = np.sort(np.unique(_sample_keys(batch), return_index=True)[1])
    return indices


def _sample_keys(batch: Batch) -> np.ndarray:
    """Stamps and values of each sample as one key, equal for exact copies."""
    values = np.ascontiguousarray(batch.values).view(np.int64)
    rows = np.column_stack([batch.seq, batch.t_acq_ns, batch.t_hw_ns, values.reshape(len(batch), -1)])
    return np.ascontiguousarray(rows).view(np.dtype((np.void, rows.shape[1] * rows.itemsize)))[:, 0]


def _select(batch: Batch, indices: IntArray) -> Batch:
    return Batch(batch.seq[indices], batch.t_acq_ns[indices], batch.t_hw_ns[indices], batch.values[indices])


def _concatenate(batches: Sequence[Batch]) -> Batch:
    return Batch.joined(batches, batches[0].values.shape[1])


class RunOfStream(Protocol):
    """Samples of a run of a stream, for :func:`choose_run`."""

    @property
    def device(self) -> str:
        """Name of the device."""

    @property
    def stream(self) -> Stream:
        """Declaration of the stream."""

    @property
    def t_acq_ns(self) -> IntArray:
        """The host's clock, (n,)."""


OneRun = TypeVar("OneRun", bound=RunOfStream)


def choose_run(path: Path, topics: Sequence[Sequence[OneRun]], run: int | None) -> tuple[list[OneRun], range]:
    """Choose a run of a file.

    Args:
        path: the file, for messages.
        topics: runs of each topic by time; a topic with one run has it in all runs of the file.
        run: number of the run, from 1; topics with fewer runs are not in it.

    Returns:
        The streams of the run, and the Unix times (ns) of its events.

    Raises:
        RecordingError: A topic has several runs and ``run`` is None, or there is no such run.
    """
    all_times = range(-(2**63), 2**64)
    several = [runs for runs in topics if len(runs) > 1]
    if not several:
        return [runs[0] for runs in topics], all_times
    if run is None:
        runs = several[0]
        topic = f"/{runs[0].device}/{runs[0].stream.name}"
        descriptions = "; ".join(
            f"{k}: {_describe_samples(stream.t_acq_ns)}" for k, stream in enumerate(runs, 1)
        )
        raise RecordingError(
            f"{path}: expected one run of {topic}, found {len(runs)}: {descriptions}; choose one with --run N"
        )
    most = max(map(len, several))
    if not 1 <= run <= most:
        raise RecordingError(f"{path}: --run {run}: expected a number from 1 to {most}")
    begins = [int(stream.t_acq_ns.min()) for stream in max(several, key=len)]
    begin = begins[run - 1] if run > 1 else all_times.start
    end = begins[run] if run < most else all_times.stop
    chosen = [runs[run - 1 : run] if len(runs) > 1 else runs for runs in topics]
    streams = [stream for runs in chosen for stream in runs]
    return streams, range(begin, end)


def _describe_samples(t_acq_ns: IntArray) -> str:
    """Number, begin and duration of samples (n,) with n ≥ 1, for messages."""
    first, last = int(t_acq_ns.min()), int(t_acq_ns.max())
    begin = f"{first * 1e-9:.6g} s"
    if first >= MIN_UNIX_TIME:
        begin = f"{datetime.fromtimestamp(first * 1e-9, UTC):%Y-%m-%d %H:%M:%S} UTC"
    return f"{len(t_acq_ns)} samples, {(last - first) * 1e-9:.6g} s from {begin}"
