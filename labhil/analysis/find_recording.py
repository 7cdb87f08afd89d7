"""Where the recording of a result is now: as its result states it, or beside the result."""

from __future__ import annotations

from pathlib import Path

from labhil.recording.memory_maps import sha256_of_file


def find_recording(result: Path, stated: Path, sha256: str = "") -> Path | None:
    """Find the recording that a result names, which may have been moved together with it.

    Args:
        result: The file of the result.
        stated: The path of the recording in it.
        sha256: The hash of the recording in it; decides where files of that name are in several places.

    Returns:
        Its path, as stated, relative to the folder of the result, or in that folder; None where none of these
        is a file.
    """
    candidates = dict.fromkeys((stated, result.parent / stated, result.parent / stated.name))
    files = [path for path in candidates if path.is_file()]
    if len(files) > 1 and sha256:
        return next((path for path in files if sha256_of_file(path) == sha256), files[0])
    return files[0] if files else None
