"""The rig file of recordings: the given one, or the one in them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from labhil.analysis.simulator_names import check_signal_names
from labhil.errors import RecordingError
from labhil.recording.recording import Recording
from labhil.recording.rig_attachments import rig_attachment_name
from labhil.rig import RigFile, load_rig

RIG_SECTIONS = ("known", "nominal", "metric")


def common_rig(recordings: Sequence[Recording], rig_file: Path | RigFile | None) -> RigFile:
    """Return the rig file of all recordings: the given one, or the one in each of them.

    Raises:
        RecordingError: Their rig files are of different kinds, or differ in a value.
    """
    rigs = [rig_of(recording, rig_file) for recording in recordings]
    first_rig, first_recording = rigs[0], recordings[0]
    for rig, recording in zip(rigs[1:], recordings[1:], strict=True):
        if rig.kind.name != first_rig.kind.name:
            raise RecordingError(
                f"{recording.path}: expected a recording of {first_rig.kind.name} as {first_recording.path}, "
                f"found one of {rig.kind.name}"
            )
        for section in RIG_SECTIONS:
            first_values, values = (_section_values(each_rig, section) for each_rig in (first_rig, rig))
            for name in sorted(first_values.keys() | values.keys()):
                first_value, value = first_values.get(name), values.get(name)
                if first_value != value:
                    raise RecordingError(
                        f"{recording.path}: its rig file says [{section}] {name} = {_value_text(value)}, "
                        f"that of {first_recording.path} {_value_text(first_value)}; give one for all "
                        "with --rig"
                    )
    return first_rig


def _section_values(rig: RigFile, section: str) -> dict[str, object]:
    """Values of a section; files of the rig file are compared by content, not by path."""
    values: dict[str, object] = dict(rig.model_dump()[section])
    if section == "known":
        values |= {
            name: f"a file with SHA-256 {hashlib.sha256(content).hexdigest()}"
            for name, content in rig.files.items()
        }
    return values


def _value_text(value: object) -> str:
    return "nothing" if value is None else str(value)


def rig_of(recording: Recording, rig_file: Path | RigFile | None) -> RigFile:
    """Return the given rig file, or the one in the recording.

    Raises:
        RecordingError: The recording has no rig file, or lacks the signals of the given one.
    """
    if rig_file is not None:
        rig = rig_file if isinstance(rig_file, RigFile) else load_rig(rig_file)
        check_signal_names(recording, rig)
        return rig
    if recording.rig is None:
        if rig_attachment_name() in recording.ambiguous:
            raise RecordingError(
                f"{recording.path}: expected one rig file, found several that differ, as in files that were "
                "merged; say which one holds with --rig RIG.toml"
            )
        if rig_attachment_name() in recording.attachments:
            raise RecordingError(
                f"{recording.path}: its rig file names a simulator of its author's, which is not loaded from "
                "there; give it with --rig RIG.toml or --simulator FILE"
            )
        damage = f" ({recording.damage})" if recording.damage else ""
        raise RecordingError(
            f"{recording.path}: carries no rig file{damage}; give one with --rig RIG.toml (that of a "
            "simulator of your own always has to be given: files that came with a recording are not loaded)"
        )
    return recording.rig
