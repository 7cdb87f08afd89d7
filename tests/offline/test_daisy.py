"""Measured data of a real ball and beam (DaISy), from the text file to what may be said of the rig."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

RIG = Path(__file__).parents[2] / "docs" / "measured" / "daisy.toml"
TERMS = "viscous_friction,coulomb_friction,time_delay"
ACROSS_WINDOWS = ("1.0", "2.0")


@pytest.fixture
def recording(labhil, daisy, tmp_path):
    done = labhil("import", daisy, "--rig", RIG, "-o", "daisy.mcap")
    assert (done.status, done.out) == (0, "daisy.mcap\n")
    assert "1000 of 1000 rows, 99.9 s at 10 Hz" in done.err
    return tmp_path / "daisy.mcap"


def fitted(labhil, recording: Path, *arguments: str) -> tuple[dict[str, Any], str]:
    done = labhil("fit", recording, "--terms", TERMS, "--holdout", "0.5", "--json", "fit.json", *arguments)
    assert done.status == 0, done.err
    return json.loads(recording.with_name("fit.json").read_text()), done.out


def rows_of(result: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in result["parameters"]}


def test_every_number_of_the_table_comes_back_out_of_the_recording(labhil, recording, daisy, tmp_path):
    done = labhil("export", recording, "-o", "again.csv")
    assert (done.status, done.out) == (0, "again.csv\n")
    header = (tmp_path / "again.csv").read_text().splitlines()[0].split(",")
    again = np.loadtxt(tmp_path / "again.csv", delimiter=",", skiprows=1)
    raw = np.loadtxt(daisy)
    assert np.array_equal(again[:, header.index("beam_angle")], raw[:, 0])
    assert np.array_equal(again[:, header.index("ball_position")], raw[:, 1])
    assert np.allclose(again[:, header.index("t")], 0.1 * np.arange(1000), atol=1e-9)


def test_gain_delay_and_friction_of_the_real_rig(labhil, recording):
    result, text = fitted(labhil, recording)
    rows = rows_of(result)
    gain, delay = rows["acceleration_per_radian"], rows["time_delay.delay"]
    assert 3.8 <= gain["value"] <= 4.6
    assert gain["unit"] == "m/s²"
    assert gain["significant"]
    assert 3.0 < gain["ci99"][0] < gain["value"] < gain["ci99"][1] < 6.0
    # the solid ball that rolls without slipping on a plane beam is ruled out
    assert gain["ci99"][1] < 5.0 / 7.0 * 9.81
    assert round(delay["value"] / 0.1) in (1, 2)
    for name in ("viscous_friction.coefficient", "coulomb_friction.level"):
        assert not rows[name]["significant"]
        assert rows[name]["ci99"][0] <= 0.0
    assert result["test"]["r2"] > 0.5
    assert result["window"] < 3.0
    assert [entry["window"] for entry in result["by_window"]] == [0.75, 1.5, 3.0, 6.0]
    for told in ("How the estimates move with the fitted window", "acceleration_per_radian", "test"):
        assert told in text


@pytest.mark.extended
@pytest.mark.parametrize("window", ACROSS_WINDOWS)
def test_the_gain_stands_on_windows_of_one_and_two_seconds(labhil, recording, window):
    result, _ = fitted(labhil, recording, "--window", window)
    gain = rows_of(result)["acceleration_per_radian"]
    assert 3.8 <= gain["value"] <= 4.6
    assert gain["std_error"] < 0.6
    assert result["window"] == float(window)


def test_the_second_half_is_held_out_after_a_gap(labhil, recording):
    from labhil.analysis.dataset import load_dataset

    dataset = load_dataset(recording, holdout=0.5)
    assert dataset.test.t[0] == pytest.approx(49.95, abs=0.11)
    assert dataset.test.t[0] - dataset.train.t[-1] >= 4.0
    assert dataset.test.t[-1] == pytest.approx(99.9)


def the_gain_has_changed(found) -> None:
    (changed,) = found["changed"]
    assert (changed["name"], changed["before"]) == ("acceleration_per_radian", 7.0)
    assert changed["ci99"][0] < 4.2 < changed["ci99"][1]


@pytest.mark.long
def test_beside_a_random_force_evidence_tells_the_gain_and_that_more_is_left(labhil, recording):
    """Whether a delay is there beside the force that drives the ball, these data leave open."""
    rig = recording.with_name("nominal.toml")
    rig.write_text(RIG.read_text() + "\n[nominal]\nacceleration_per_radian = 7.0\n")
    done = labhil("diagnose", recording, "--rig", rig, "--json", "by_evidence.json")
    assert done.status == 0, done.err
    found = json.loads(recording.with_name("by_evidence.json").read_text())
    assert found["verdict"] == "unexplained_mismatch"
    assert found["missing"] == []
    assert "time_delay" in {left["term"] for left in found["undecided"]}
    the_gain_has_changed(found)
