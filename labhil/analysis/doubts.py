"""What the physics of a rig calls implausible in a recording: units, signs, times or columns."""

from __future__ import annotations

from labhil.errors import LabhilError
from labhil.identify.plausibility import doubts_of
from labhil.physics.rigs import record_of
from labhil.recording.recording import Recording


def doubts_in(recording: Recording) -> list[str]:
    """A sentence for each; none of a recording that lacks a rig file, or what a model needs."""
    if recording.rig is None:
        return []
    try:
        record = record_of(recording, recording.rig.kind)
        doubts = doubts_of(record, recording.rig, time_column=recording.time_column)
        return [doubt.statement for doubt in doubts]
    except LabhilError:
        return []
