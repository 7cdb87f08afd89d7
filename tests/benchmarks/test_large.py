"""Commands on a recording of 10⁵ samples: ``measure_large.py`` in short."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))
import measure_large

SAMPLES = 100_000
MOST = 400.0
"""MB: 142 MB were measured for `info` of so many samples, which take 23 MB in the file."""


@pytest.mark.extended
def test_info_and_recover_need_little_memory(tmp_path: Path) -> None:
    figures = measure_large.measure(SAMPLES, ["info", "recover"], 300.0, tmp_path, None)
    for name, command in figures["commands"].items():
        assert command["exit_status"] == 0, (name, command)
        assert 0.0 < command["anonymous_mb"] < MOST, (name, command)
        assert command["cpu_seconds"] > 0.0
