"""The result log of a lab: a line of JSON for every study, in ``results.jsonl`` beside the recordings."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from labhil.documents import parse_json
from labhil.recording.memory_maps import sha256_of_file
from labhil.version import __version__

RESULT_LOG = "results.jsonl"
SCHEMA = "labhil.catalogued/1"
PACKAGES = ("numpy", "scipy", "numba", "mcap")
"""Packages besides labhil that results depend on."""


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of the packages that results depend on."""
    package_versions = {
        "labhil": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
    }
    for name in PACKAGES:
        try:
            package_versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return package_versions


def append_entry(folder: Path, entry: Mapping[str, Any], recording: Path) -> None:
    """Append a line about a study to the folder's ``results.jsonl``, and sync it to the disk.

    Args:
        folder: folder of recordings and results.
        entry: the study and its outcome.
        recording: the recording; the line holds its checksum.

    Raises:
        OSError: the line cannot be written.
    """
    line = {
        "schema": SCHEMA,
        "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "recording": recording.name,
        "sha256": _checksum(recording),
        **entry,
        "versions": dict(versions()),
    }
    data = json.dumps(line, ensure_ascii=False, allow_nan=False).encode() + b"\n"
    # a single write at the end of the file cannot damage earlier lines
    descriptor = os.open(folder / RESULT_LOG, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(descriptor, data)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def unstudied_recordings(folder: Path) -> list[Path]:
    """Return recordings that no worker has studied.

    They are newer than the first entry of the folder's log and have no entry. A folder without any entry has
    none: no worker ever ran there. Lines that cannot be read are ignored.
    """
    entries = list(_entries(folder))
    if not entries:
        return []
    first_time = min(datetime.fromisoformat(entry["time"]).timestamp() for entry in entries)
    known = {entry["recording"] for entry in entries}
    return sorted(
        path for path in folder.glob("*.mcap") if path.name not in known and _changed_at(path) > first_time
    )


def _changed_at(path: Path) -> float:
    """Time of a file's last change, s; −∞ for a file that does not exist any more."""
    try:
        return path.stat().st_mtime
    except OSError:
        return float("-inf")


def _entries(folder: Path) -> Iterator[dict[str, str]]:
    """Time and recording of each readable line of a folder's ``results.jsonl``."""
    try:
        lines = (folder / RESULT_LOG).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        try:
            entry = parse_json(line)
            datetime.fromisoformat(entry["time"])
            yield {"time": entry["time"], "recording": str(entry["recording"])}
        except (ValueError, KeyError, TypeError):
            continue


def verdict_of(result: Path) -> str | None:
    """Return the verdict of a result file; None where it has none or cannot be read."""
    try:
        verdict = parse_json(result.read_text(encoding="utf-8")).get("verdict")
    except (OSError, ValueError, AttributeError):
        return None
    return verdict if isinstance(verdict, str) else None


def _checksum(path: Path) -> str | None:
    try:
        return sha256_of_file(path)
    except OSError:
        return None
