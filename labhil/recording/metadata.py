"""Metadata and rig kinds of a finished recording, read from the index at its end, without its samples.

``reader.py`` reads everything else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, TypeVar, cast

from mcap.reader import SeekingReader
from mcap.records import Attachment, Metadata
from mcap.summary import Summary

from labhil.errors import RecordingError
from labhil.recording.bounded_file import BoundedFile
from labhil.recording.rig_attachments import attached_rig, rig_attachment_name
from labhil.unreadable import RECORDING, reason_unreadable

Record = TypeVar("Record", Attachment, Metadata)

MAX_RECORD_SIZE = 64 << 20
"""Largest record at the end of a file, bytes."""


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """Read the metadata of a recording.

    Args:
        path: an MCAP file; its samples are neither read nor checked.

    Returns:
        Tables of strings by name, such as ``{"end": {"exit_status": "0", …}}``.

    Raises:
        RecordingError: The file cannot be read, or has no index, as after its recorder was killed.
    """
    summary, metadata = _read_end(path, SeekingReader.iter_metadata)
    names = [] if summary is None else [index.name for index in summary.metadata_indexes]
    if not names or [record.name for record in metadata] != names:
        raise RecordingError(f"{path}: expected a finished recording, found no index of its metadata")
    return {record.name: dict(record.metadata) for record in metadata}


def read_rig_kinds(path: Path) -> dict[str, str | None]:
    """Read the rig kind of each device of a recording.

    Args:
        path: an MCAP file; its samples are neither read nor checked.

    Returns:
        Rig kinds by device; None for a device without a rig file.

    Raises:
        RecordingError: The file cannot be read, has no end, or has a rig file that cannot be used.
    """
    summary, attachments = _read_end(path, SeekingReader.iter_attachments)
    contents = {attachment.name: attachment.data for attachment in attachments}
    channels = [] if summary is None else list(summary.channels.values())
    devices = dict.fromkeys(
        channel.metadata["device"]
        for channel in channels
        if "labhil.stream" in channel.metadata and "device" in channel.metadata
    )
    kinds: dict[str, str | None] = {}
    for device in devices:
        rig = attached_rig(path, contents, device if rig_attachment_name(device) in contents else None)
        kinds[device] = None if rig is None else rig.kind.name
    return kinds


def _read_end(
    path: Path, records: Callable[[SeekingReader], Iterable[Record]]
) -> tuple[Summary | None, list[Record]]:
    """The summary at the end of a file, and the ``records`` that it lists."""
    try:
        with path.open("rb") as file:
            reader = SeekingReader(cast(IO[bytes], BoundedFile(file)), record_size_limit=MAX_RECORD_SIZE)
            summary = reader.get_summary()
            return summary, [] if summary is None else list(records(reader))
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be read: {reason_unreadable(path, error, RECORDING)}"
        ) from error
    except Exception as error:  # struct, mcap and the text decoder each raise their own
        raise RecordingError(f"{path}: expected a finished recording, found: {error}") from error
