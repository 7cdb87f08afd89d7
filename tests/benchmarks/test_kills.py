"""What a killed recorder leaves, held against what was published: ``measure_kills.py`` in short."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest

from labhil.bus import latch
from labhil_benchmarks.left_files import PAGE, examine, variants

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))
import kill_trials
from measure_safety import twin_behind_a_relay


def test_a_power_failure_keeps_what_was_forced_to_the_disk() -> None:
    data = bytes(range(1, 251)) * 200
    made = dict(variants(data, 1000, random.Random(1)))
    assert made["killed"] == data
    assert made["power lost: cut"] == data[:1000]
    pages = made["power lost: pages"]
    assert len(pages) == len(data) and pages[:1000] == data[:1000]
    each = [pages[start : start + PAGE] for start in range(1000, len(data), PAGE)]
    kept = [any(page) for page in each]
    assert any(kept) and not all(kept)


@pytest.mark.extended
def test_a_killed_recorder_leaves_all_but_the_last_moment(tmp_path: Path) -> None:
    trial = kill_trials.kill_recorder(None, tmp_path, random.Random(2))
    assert len(trial["files"]) == 3
    for left in trial["files"]:
        assert left["fault"] == "" and left["saved"] > 100, left
        assert (left["wrong"], left["unheard"], left["holes"]) == (0, 0, 0), left
    # and the measure itself notices a sample that was published otherwise, and one that was not
    path = next((tmp_path / "lab").glob("*.mcap*"))
    log = {f"/{name}/state": kill_trials.published_in(tmp_path / f"{name}.log") for name in ("one", "two")}
    first = min(log["/one/state"])
    log["/one/state"][first] = log["/one/state"][first][:-1] + b"\x01"
    del log["/two/state"][first + 1]
    assert examine("changed", path.read_bytes(), log, 0, 1 << 62, tmp_path).wrong == 2


@pytest.mark.extended
@pytest.mark.parametrize("kind", ["run", "host", "twin", "serve", "study", "tui"])
def test_one_kill_of_each_kind(tmp_path: Path, kind: str) -> None:
    with twin_behind_a_relay("solenoid", kill_trials.SAMPLING) as relay:
        try:
            trial = kill_trials.KINDS[kind](relay, tmp_path, random.Random(3))
        finally:
            latch.release()
    assert trial["processes_left"] == []
    for left in trial.get("files", []):
        assert (left["wrong"], left["holes"]) == (0, 0), left
        # a busy machine forces the first samples to the disk late: before that, a power failure leaves none
        lost_all = left["variant"].startswith("power lost") and left["synced"] <= kill_trials.BEGUN
        assert left["fault"] == "" or (lost_all and "found no complete one" in left["fault"]), left
    if kind in ("host", "twin"):
        assert "complete True" in trial["end"] and not trial["end"].startswith("exit 0")
    if kind in ("study", "tui"):
        assert "device active: True" in trial["end"]
