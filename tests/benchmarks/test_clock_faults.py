"""Clocks that are set, wrap or stand still in a run: ``measure_clock_faults.py`` in short."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))
import patient_labhil

import measure_clock_faults

NAMES = [
    "wall clock set back by 1 h",
    "machine suspended for 20 s",
    "machine suspended for 2 h",
    "micros() wraps while suspended",
    "host stopped for 2 s",
]


@pytest.mark.extended
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("name", NAMES)
def test_order_and_spacing_are_right_and_somebody_says_so(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(measure_clock_faults, "LABHIL", patient_labhil.COMMAND)
    found = measure_clock_faults.measure(measure_clock_faults.CASES[name], tmp_path)
    assert (found["exit_status"], found["not_ours"], found["out_of_order"]) == (0, 0, 0), found
    assert found["missing"] == found["missing_by_seq"] and found["flagged"], found
    assert found["spacing_error_ms"] < 0.01, found
