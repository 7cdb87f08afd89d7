"""What became of each recording of a lab: a line of JSON for every study, beside the recordings."""

from __future__ import annotations

import hashlib
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
from labhil.version import __version__

RESULT_LOG = "results.jsonl"
SCHEMA = "labhil.catalogued/1"
PACKAGES = ("numpy", "scipy", "numba", "mcap")
"""What a number may depend on besides labhil itself."""


@cache
def versions() -> Mapping[str, str]:
    """The versions of the packages that results depend on."""
    by_package = {"labhil": __version__, "python": platform.python_version(), "platform": platform.platform()}
    for name in PACKAGES:
        try:
            by_package[name] = version(name)
        except PackageNotFoundError:
            continue
    return by_package


def catalogue(folder: Path, entry: Mapping[str, Any], recording: Path) -> None:
    """Add a line about a study to the folder's ``results.jsonl``, and force it to the disk.

    Args:
        folder: Where recordings and results are.
        entry: What was done and what came of it.
        recording: What it was done with; its checksum says later whether it is still the same.

    Raises:
        OSError: The line cannot be written.
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
    # one write at the end of the file: a killed service leaves no half of an earlier line
    descriptor = os.open(folder / RESULT_LOG, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(descriptor, data)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def unstudied_recordings(folder: Path) -> list[Path]:
    """Recordings that were finished while no worker ran, or that a worker did not reach.

    They are newer than the folder's first entry and have none of their own. A folder without any entry has
    none: no worker ever ran there. Lines that cannot be read are ignored.
    """
    entries = list(_entries(folder))
    if not entries:
        return []
    began = min(datetime.fromisoformat(entry["time"]).timestamp() for entry in entries)
    known = {entry["recording"] for entry in entries}
    return sorted(
        path for path in folder.glob("*.mcap") if path.name not in known and _changed_at(path) > began
    )


def _changed_at(path: Path) -> float:
    """When a file was written last, s; long ago for one that is gone by now."""
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
    """The verdict that a result states; None where it has none or cannot be read."""
    try:
        verdict = parse_json(result.read_text(encoding="utf-8")).get("verdict")
    except (OSError, ValueError, AttributeError):
        return None
    return verdict if isinstance(verdict, str) else None


def _checksum(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
