"""The signals of a rig in recordings: the part that is used, with what only the complete recording shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from labhil.analysis.stretch import liveliest_stretch
from labhil.diagnose.intake import mark_censored
from labhil.errors import OptionError, RecordingError
from labhil.identify.windows import FEWEST_SAMPLES, with_least_noise
from labhil.physics.joining import join_records
from labhil.physics.measured_input import with_input_smoothing
from labhil.physics.record import Record
from labhil.physics.rigs import record_of
from labhil.recording.recording import Recording
from labhil.rig import RigFile


def refuse_holes(path: Path, record: Record) -> None:
    """Raise RecordingError where inputs or outputs are not finite, or times do not increase.

    Args:
        path: The recording's file, for the message.
        record: What was measured.
    """
    stalled = np.flatnonzero(np.diff(record.t) <= 0.0)
    if len(stalled):
        raise RecordingError(
            f"{path}: expected times that increase, found {len(stalled)} that do not, the first after "
            f"{record.t[stalled[0]]:g} s; `labhil diagnose` tells more of its faults"
        )
    names = (*record.input_names, *record.output_names)
    for name, values in zip(names, np.hstack([record.inputs, record.outputs]).T, strict=True):
        unusable = np.flatnonzero(~np.isfinite(values))
        if len(unusable):
            raise RecordingError(
                f"{path}: {name}: expected finite numbers, found {len(unusable)} of {len(values)} samples "
                f"that are none, the first at {record.t[unusable[0]]:g} s; `labhil export` to a table and "
                "`labhil import` of that drop such rows"
            )


def measured_of(
    recordings: Sequence[Recording],
    rig: RigFile,
    span: tuple[float, float] | None = None,
    like: Record | None = None,
    of: Recording | None = None,
    most: int | None = None,
) -> tuple[list[Record], Record]:
    """Extract the signals of a rig from recordings.

    Args:
        recordings: One or more.
        rig: The rig file.
        span: Part of each recording that is used, from … to, s.
        like: A record whose input the recordings must have, too.
        of: The recording of that record, for the message.
        most: Number of samples of each recording that are used; None for all.

    Returns:
        A record for each recording, and all of them joined.

    Raises:
        RecordingError: A recording has another input than ``like``.
    """
    records = [_part_of(recording, rig, span, most) for recording in recordings]
    for recording, record in zip(recordings, records, strict=True):
        if like is not None and of is not None and record.input_names != like.input_names:
            raise RecordingError(
                f"{recording.path}: expected the input {like.input_names[0]} as in {of.path}, "
                f"found {record.input_names[0]}"
            )
    return records, join_records(records, [str(recording.path) for recording in recordings])


def _part_of(
    recording: Recording, rig: RigFile, span: tuple[float, float] | None, most: int | None
) -> Record:
    """The annotated part of a recording that is used; a long one is cut before anything else is computed."""
    record = record_of(recording, rig.kind)
    stretch = liveliest_stretch(_cut_to_span(record, span, recording), most)
    if stretch.begins[0].left_out:
        return _annotate(stretch, rig)
    return _cut_to_span(_annotate(record, rig), span, recording)


def _annotate(record: Record, rig: RigFile) -> Record:
    """Add the holds that the rig file states, and properties that only the complete record shows.

    These are the noise of channels that rest for a part of it, the noise of a measured input, and readings at
    the ends of their range.
    """
    record = with_least_noise(record.with_holds({n: c.hold for n, c in rig.channels.items() if c.hold}))
    record = with_input_smoothing(record)
    return record if record.has_joints else mark_censored(record)


def _cut_to_span(record: Record, span: tuple[float, float] | None, recording: Recording) -> Record:
    """The samples of a record within ``span`` (s, both ends counted); UsageError where hardly any are."""
    if span is None:
        return record
    begin, end = np.searchsorted(record.t, span[0]), np.searchsorted(record.t, span[1], side="right")
    if end - begin < FEWEST_SAMPLES:
        raise OptionError(
            "span",
            f" {span[0]:g} {span[1]:g}: expected at least {FEWEST_SAMPLES} samples of "
            f"{recording.path}, which reaches from {record.t[0]:g} to {record.t[-1]:g} s, "
            f"found {max(end - begin, 0)}",
        )
    return record.part(int(begin), int(end))
