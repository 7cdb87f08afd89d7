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
    """The versions of what makes results here."""
    found = {"labhil": __version__, "python": platform.python_version(), "platform": platform.platform()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


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


def left_behind(folder: Path) -> list[Path]:
    """Recordings that were finished while no worker was there, or that one could not get to.

    They are newer than the folder's first entry and have none of their own. In a folder where no worker ever
    was there are none: what lies there is nobody's order. Lines that cannot be read count for nothing.
    """
    entries = list(_entries(folder))
    if not entries:
        return []
    began = min(datetime.fromisoformat(entry["time"]).timestamp() for entry in entries)
    known = {entry["recording"] for entry in entries}
    return sorted(
        path for path in folder.glob("*.mcap") if path.name not in known and path.stat().st_mtime > began
    )


def _entries(folder: Path) -> Iterator[dict[str, str]]:
    """The lines of a folder's ``results.jsonl`` that say when something came of which recording."""
    try:
        lines = (folder / RESULT_LOG).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        try:
            found = parse_json(line)
            datetime.fromisoformat(found["time"])
            yield {"time": found["time"], "recording": str(found["recording"])}
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
