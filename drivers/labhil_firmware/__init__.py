"""What the firmware of all benches has in common; each driver's own is in its folder ``firmware``."""

from __future__ import annotations

import shutil
from pathlib import Path

from labhil.errors import UsageError

SHARED = Path(__file__).parent / "shared"
"""C sources that every bench is built with."""

BUILT = shutil.ignore_patterns("build", "__pycache__")


def write_sources(firmware: Path, out: Path) -> None:
    """Copy a bench's ``firmware`` and what it shares to ``out``, ready for ``make``.

    UsageError when something is there already, or when it cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out}: expected a new or an empty folder, found something in it")
    try:
        shutil.copytree(firmware, out, ignore=BUILT, dirs_exist_ok=True)
        shutil.copytree(SHARED, out / "shared", ignore=BUILT)
    except OSError as error:
        raise UsageError(f"{out}: the firmware cannot be written: {error}") from error
