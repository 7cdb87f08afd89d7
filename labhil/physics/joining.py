"""Joins several recordings with the same channels into one record."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.errors import RecordingError
from labhil.physics.record import Record

CHANNEL_KINDS = ("inputs", "hold of the inputs", "outputs", "units", "joints", "other channels")


def join_records(records: Sequence[Record], names: Sequence[str] = ()) -> Record:
    """Join recordings into one record, one after another and numbered from 1.

    Args:
        records: Records of one or more recordings.
        names: Names of the recordings for messages.

    Returns:
        The joined record; a single recording is returned as it is.

    Raises:
        RecordingError: A recording has no samples, or other channels than the first.
    """
    recordings = [recording for record in records for recording in record.recordings()]
    if len(recordings) == 1:
        return recordings[0]
    labels = list(names) or [f"recording {number}" for number in range(1, len(recordings) + 1)]
    for name, record in zip(labels, recordings, strict=True):
        if not len(record):
            raise RecordingError(f"{name}: expected samples, found 0")
        for what, expected, actual in zip(
            CHANNEL_KINDS, _channels(recordings[0]), _channels(record), strict=True
        ):
            if expected != actual:
                raise RecordingError(
                    f"{name}: expected the {what} {_listed(expected)} as in {labels[0]}, "
                    f"found {_listed(actual)}: recordings that are fitted together need the same channels"
                )
    return recordings[0].followed_by(recordings[1:])


def _channels(record: Record) -> tuple[tuple[object, ...], ...]:
    """Properties that joined records share, in the order of ``CHANNEL_KINDS``."""
    holds = tuple(hold.value for hold in record.input_holds)
    outputs = (record.output_names, record.output_units, record.output_joints)
    return (record.input_names, holds, *outputs, tuple(sorted(record.auxiliary)))


def _listed(names: Sequence[object]) -> str:
    """Names for a message."""
    return ", ".join(str(name) for name in names) or "none"
