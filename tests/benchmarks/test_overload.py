"""What is lost where a recorder cannot keep up is counted: ``measure_overload.py`` in short."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))
import measure_overload


@pytest.mark.extended
@pytest.mark.parametrize("who", ["the recorder", "another subscriber"])
def test_each_sample_is_recorded_or_counted(
    who: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measure_overload, "AFTER", 0.2)
    trial = measure_overload.frozen(who, 3.0, tmp_path, random.Random(1))
    assert trial["published"] > 10_000 and trial["complete"]
    assert (trial["wrong"], trial["lost"]) == (0, trial["gaps_in_its_last_status"])
