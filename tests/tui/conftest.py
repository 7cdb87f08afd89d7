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

PILOT = """
[experiment]
name = "pilot"
[devices.bench]
plugin = "ball_beam"
address = "twin"
twin = { speed = 2.0, seed = 1 }
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "two_sine"
frequencies = [0.23, 0.31]
amplitude = 0.3
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
duration = 300.0
"""


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


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Return a folder with the experiment pilot.toml, of five minutes on a simulated ball and beam."""
    (tmp_path / "pilot.toml").write_text(PILOT, encoding="utf-8")
    return tmp_path
