"""What a finished recording says of itself, read from the end of its file without its samples."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import SeekingReader

from labhil.errors import RecordingError

LARGEST_RECORD = 64 << 20
"""Bytes of a record at the end of a file, at most."""


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """Read the metadata of a recording by the index at its end.

    Args:
        path: An MCAP file. Its samples are neither read nor checked.

    Returns:
        The tables of strings by their names, such as ``{"end": {"exit_status": "0", …}}``.

    Raises:
        RecordingError: The file cannot be read, or has no end, as one whose recorder was killed.
    """
    try:
        with path.open("rb") as file:
            reader = SeekingReader(file, record_size_limit=LARGEST_RECORD)
            summary = reader.get_summary()
            records = [] if summary is None else list(reader.iter_metadata())
    except Exception as error:  # struct, mcap and the decoder of text each raise their own
        raise RecordingError(f"{path}: expected a finished recording, found: {error}") from error
    names = [] if summary is None else [index.name for index in summary.metadata_indexes]
    if not names or [record.name for record in records] != names:
        raise RecordingError(f"{path}: expected a finished recording, found no index of its metadata")
    return {record.name: dict(record.metadata) for record in records}
