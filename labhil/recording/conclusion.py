"""The verdict on a recording, and the next steps with it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from labhil.recording.contents import compatible_kinds, recording_status
from labhil.recording.recording import Recording

ENDINGS = {
    "done": "The recording is complete, and its run ended in order",
    "imported": "The recording is complete, made from imported data",
    "failed": "The recording is complete, but its run failed",
    "no end": "The recording has no end",
}
"""The first part of the verdict, by the status of the recording."""


def is_flawless(recording: Recording) -> bool:
    """Whether a recording is complete, ended in order, and lost no sample."""
    status = recording_status(recording)
    return status in {"done", "imported"} and not any(data.lost for data in recording.streams)


def verdict_on(recording: Recording) -> str:
    """Return in one sentence whether a recording is complete, how it ended, and what it lost."""
    status = recording_status(recording)
    if status == "no end" and recording.metadata.get("end"):
        return f"The recording is damaged; {_losses(recording)}."
    return f"{ENDINGS[status]}; {_losses(recording)}."


def _losses(recording: Recording) -> str:
    lost = sum(data.lost for data in recording.streams)
    n_gaps = sum(int(np.count_nonzero(np.diff(data.seq) > 1)) for data in recording.streams)
    if not lost:
        return "no sample was lost"
    samples = "1 sample was" if lost == 1 else f"{lost} samples were"
    return f"{samples} lost in {n_gaps} {'gap' if n_gaps == 1 else 'gaps'}"


def steps_with(recording: Recording) -> tuple[str, ...]:
    """Return the next steps with a recording, the most useful first: a sentence or two each."""
    return tuple(_steps_with(recording))


def _steps_with(recording: Recording) -> Iterator[str]:
    path, status = recording.path, recording_status(recording)
    if status == "no end":
        yield f"`labhil recover {path} -o saved.mcap` saves every whole message, and reports the losses."
    elif status == "failed":
        yield (
            f"The run ended early ({recording.metadata['end'].get('reason') or 'for an unknown reason'}): "
            "record it again, or use what there is."
        )
    kinds = compatible_kinds(recording)
    if recording.rig is not None:
        yield (
            f"`labhil fit {path}` fits a model to it; `labhil diagnose {path}` says which physics a model "
            "leaves out."
        )
    elif kinds:
        yield (
            f"It holds the signals of {' or '.join(kinds)}, but no rig file: write one "
            f"(docs/reference/rig-file.md), then `labhil diagnose {path} --rig RIG.toml`."
        )
