"""A cable that is cut again and again in one run: ``measure_cuts.py`` in short."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))

import measure_cuts


def check(found: dict[str, object], cuts: int) -> None:
    assert found["cuts"] == cuts and str(found["end"]).startswith("exit 0"), found
    assert (found["not_sent_so"], found["out_of_order"], found["old_as_new"]) == (0, 0, 0), found
    assert found["cuts_not_marked"] == [], found
    assert found["all"]["never_back"] == 0, found  # type: ignore[index]


@pytest.mark.long  # a machine with no time for 0.2 s ends such a run, as it should
@pytest.mark.parametrize("rig", ["ball_beam", "solenoid"])
def test_a_serial_device_comes_back_after_each_cut(
    rig: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    found = measure_cuts.measure(rig, 8, tmp_path, random.Random(5))
    check(found, 8)
    assert found["configurations"] >= found["connections"] > 1


@pytest.mark.by_hand  # a controller whose program ends while the cable is out ends the run, as it should
def test_an_arm_comes_back_after_each_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    check(measure_cuts.measure("ur5", 4, tmp_path, random.Random(2)), 4)


@pytest.mark.extended
def test_a_device_that_is_late_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert measure_cuts.late_at_start("ball_beam", tmp_path, random.Random(1), 1)["never_came"] == 0
