"""A rig file in a recording: it, and the files that it names, are attached and found again on any machine."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePath

from labhil.errors import RecordingError, RigFileError
from labhil.rig import OwnSimulatorError, RigFile, parse_rig

RIG_ATTACHMENT = "rig.toml"


def rig_attachments(rig: RigFile, device: str | None = None) -> dict[str, bytes]:
    """Return what to attach of a rig file: its text, and the files that its ``[known]`` names.

    Args:
        rig: The rig file.
        device: Whose it is, where it is not that of the recording's first device.

    Returns:
        Contents by the names of attachments: ``rig.toml`` or ``rig.<device>.toml``, and beside that
        ``rig.known.<name><extension>``.

    Raises:
        RigFileError: A file that the rig file names cannot be read.
    """
    name = rig_attachment_name(device)
    files = {
        _file_name(name, key, str(rig.known[key])): file.content
        for key, what in rig.kind.known.items()
        if what.table and (file := rig.known_file(key)) is not None
    }
    return {name: rig.text.encode(), **files}


def rig_attachment_name(device: str | None = None) -> str:
    """What the rig file of a device is called among the attachments; the first device's for None."""
    return RIG_ATTACHMENT if device is None else f"rig.{device}.toml"


def attached_rig(path: Path, attachments: Mapping[str, bytes], device: str | None = None) -> RigFile | None:
    """Read the rig file that the recording ``path`` carries, with the files that it names.

    Returns:
        The rig file; None when the recording carries none, or one whose simulator is a Python file.

    Raises:
        RecordingError: It carries one that cannot be used.
    """
    name = rig_attachment_name(device)
    if name not in attachments:
        return None
    try:
        text, place = attachments[name].decode("utf-8"), path.parent / name
        rig = parse_rig(text, place)
        files = {
            key: attachments[file]
            for key, value in rig.known.items()
            if (file := _file_name(name, key, str(value))) in attachments
        }
        return parse_rig(text, place, files) if files else rig
    except OwnSimulatorError:
        return None  # code that came with data is not run: who analyses it names the rig file
    except (UnicodeDecodeError, RigFileError) as error:
        raise RecordingError(f"{path}: its attached rig file cannot be used: {error}") from error


def _file_name(rig: str, key: str, value: str) -> str:
    return f"{rig.removesuffix('.toml')}.known.{key}{PurePath(value).suffix}"
