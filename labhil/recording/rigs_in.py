"""Which devices a finished recording holds, and of which rig kinds, without reading its samples."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import SeekingReader

from labhil.errors import RecordingError
from labhil.recording.metadata import LARGEST_RECORD
from labhil.recording.rig_attachments import attached_rig, rig_name


def rigs_in(path: Path) -> dict[str, str | None]:
    """Return the rig kind of each device in a recording, by the device's name; None where it has no rig file.

    Raises:
        RecordingError: The file cannot be read, has no end, or holds a rig file that cannot be used.
    """
    try:
        with path.open("rb") as file:
            reader = SeekingReader(file, record_size_limit=LARGEST_RECORD)
            summary = reader.get_summary()
            attached = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
    except Exception as error:  # struct, mcap and the decoder of text each raise their own
        raise RecordingError(f"{path}: expected a finished recording, found: {error}") from error
    channels = [] if summary is None else list(summary.channels.values())
    devices = dict.fromkeys(
        channel.metadata["device"]
        for channel in channels
        if "labhil.stream" in channel.metadata and "device" in channel.metadata
    )
    kinds: dict[str, str | None] = {}
    for device in devices:
        own = device if rig_name(device) in attached else None
        rig = attached_rig(path, attached, own)
        kinds[device] = None if rig is None else rig.kind.name
    return kinds
