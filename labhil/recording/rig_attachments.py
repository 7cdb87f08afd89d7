"""Rig files in recordings, attached with the files that they name, so that any machine can read them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePath

from labhil.errors import RecordingError, RigFileError
from labhil.rig import OwnSimulatorError, RigFile, parse_rig

RIG_ATTACHMENT = "rig.toml"


def rig_attachments(rig: RigFile, device: str | None = None) -> dict[str, bytes]:
    """Attachments of a rig file: its text, and the files that its ``[known]`` names.

    Args:
        rig: the rig file.
        device: its device; None for the recording's first device.

    Returns:
        Contents by name: ``rig.toml`` or ``rig.<device>.toml``, and ``rig.known.<name><extension>``.

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
    """Name of the attached rig file of a device; None for the first device."""
    return RIG_ATTACHMENT if device is None else f"rig.{device}.toml"


def attached_rig(path: Path, attachments: Mapping[str, bytes], device: str | None = None) -> RigFile | None:
    """Read the rig file in a recording, with the files that it names.

    Args:
        path: the recording, for messages.
        attachments: its attachments by name.
        device: the device; None for the first device.

    Returns:
        The rig file; None without one, or if its simulator is a Python file.

    Raises:
        RecordingError: The rig file cannot be used.
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
        return None  # code in data is not executed; users of the recording name the rig file themselves
    except (UnicodeDecodeError, RigFileError) as error:
        raise RecordingError(f"{path}: its attached rig file cannot be used: {error}") from error


def _file_name(rig: str, key: str, value: str) -> str:
    return f"{rig.removesuffix('.toml')}.known.{key}{PurePath(value).suffix}"
