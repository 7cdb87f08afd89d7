"""What the tests of the screen share: a folder with fixed files, and clocks that stand still."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RESULTS = Path(__file__).parent / "results"
WRITTEN = 1_790_000_000.0


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a folder of fixed recordings and results, in a time zone of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    place = Path("bench")
    place.mkdir()
    files = [*sorted((ROOT / "recordings").glob("*.mcap"))[:2], *sorted(RESULTS.iterdir())]
    for age, file in enumerate(files):
        copy = place / file.name
        shutil.copy(file, copy)
        os.utime(copy, (WRITTEN - 100 * age, WRITTEN - 100 * age))
    yield place
    monkeypatch.undo()
    time.tzset()
