"""Shared firmware of all benches; the specific part is in the folder ``firmware`` of each driver."""

from __future__ import annotations

import shutil
from pathlib import Path

from labhil.errors import UsageError

SHARED = Path(__file__).parent / "shared"
"""C sources that every bench is built with."""

BUILD_OUTPUTS = shutil.ignore_patterns("build", "__pycache__")


def write_sources(firmware: Path, out: Path) -> None:
    """Copy the firmware of a bench, complete for ``make``.

    Args:
        firmware: Its folder of specific sources.
        out: A new or empty folder.

    Raises:
        UsageError: The folder is not empty, or cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out}: expected a new or an empty folder, found something in it")
    try:
        shutil.copytree(firmware, out, ignore=BUILD_OUTPUTS, dirs_exist_ok=True)
        shutil.copytree(SHARED, out / "shared", ignore=BUILD_OUTPUTS)
    except OSError as error:
        raise UsageError(f"{out}: the firmware cannot be written: {error}") from error
