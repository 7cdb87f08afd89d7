"""Implausible units, signs, times or columns of a recording, by the physics of its rig."""

from __future__ import annotations

from labhil.errors import LabhilError
from labhil.identify.plausibility import doubts_of
from labhil.physics.rigs import record_of
from labhil.recording.recording import Recording


def doubts_in(recording: Recording) -> list[str]:
    """Return a sentence for each doubt; none of a recording without a rig file or without needed signals."""
    if recording.rig is None:
        return []
    try:
        record = record_of(recording, recording.rig.kind)
        doubts = doubts_of(record, recording.rig, time_column=recording.time_column)
        return [doubt.statement for doubt in doubts]
    except LabhilError:
        return []
