"""Several recordings as one record, if they have the same channels."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.errors import RecordingError
from labhil.physics.model import Record

CHANNELS = ("inputs", "hold of the inputs", "outputs", "units", "joints", "other channels")


def join_records(records: Sequence[Record], names: Sequence[str] = ()) -> Record:
    """Several recordings as one record, one after another, numbered from 1; a single one as it is.

    ``names`` are what messages call them. Raises RecordingError when one has no samples or other channels
    than the first.
    """
    recordings = [recording for record in records for recording in record.recordings()]
    if len(recordings) == 1:
        return recordings[0]
    labels = list(names) or [f"recording {number}" for number in range(1, len(recordings) + 1)]
    for name, record in zip(labels, recordings, strict=True):
        if not len(record):
            raise RecordingError(f"{name}: expected samples, found 0")
        for what, expected, actual in zip(CHANNELS, _channels(recordings[0]), _channels(record), strict=True):
            if expected != actual:
                raise RecordingError(
                    f"{name}: expected the {what} {_listed(expected)} as in {labels[0]}, "
                    f"found {_listed(actual)}: recordings that are fitted together need the same channels"
                )
    return recordings[0].followed_by(recordings[1:])


def _channels(record: Record) -> tuple[tuple[object, ...], ...]:
    """What records have to have in common, in the order of CHANNELS."""
    holds = tuple(hold.value for hold in record.input_holds)
    outputs = (record.output_names, record.output_units, record.output_joints)
    return (record.input_names, holds, *outputs, tuple(sorted(record.auxiliary)))


def _listed(names: Sequence[object]) -> str:
    return ", ".join(str(name) for name in names) or "none"
