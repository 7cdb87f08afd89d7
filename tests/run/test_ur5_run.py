"""Whole runs of simulated arms: two at once, and one that something happens to."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.experiment.experiment import parse_experiment
from labhil.experiment.twins import twin_command
from labhil.recording.reader import read_recording

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))
from measure_ur5_faults import suffer


def host(number: int) -> str:
    """An address of this machine that other test runs on it do not use."""
    pid = os.getpid()
    return f"127.{1 + pid % 250}.{1 + pid // 250 % 250}.{100 + number}"


def two_arms(series: str = "") -> str:
    text = '[experiment]\nname = "two arms"\n'
    for number, name in enumerate(("left", "right")):
        text += f"""
[devices.{name}]
plugin = "ur5_cb3"
address = "twin"
twin = {{ seed = {number}, host = "{host(number)}"{series}, set = {{ "home[0]" = {0.5 * number} }} }}
[[steps]]
device = "{name}"
signal = "target_q_5"
excitation = "multisine"
frequencies = [{0.4 + 0.1 * number}]
amplitude = 0.2
fade = 1.0
duration = 4.0
at = 0.0
"""
    return text


def test_an_experiment_says_where_a_networked_twin_is_and_of_which_make() -> None:
    experiment = parse_experiment(two_arms(', series = "3.15.8"'), Path("e.toml"))
    command = twin_command("ur5_cb3", experiment.devices["right"].twin, Path("answer.json"))
    assert command[command.index("--host") + 1] == host(1)
    assert command[command.index("--series") + 1] == "3.15.8"
    assert "host" not in experiment.public_text()


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_two_arms_move_in_one_run(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text(two_arms())
    command = [*PATIENT_LABHIL, "run", "e.toml", "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=250, check=False)
    assert done.returncode == 0, done.stderr
    recording = read_recording(tmp_path / json.loads(done.stdout)["path"])
    begins = {}
    for name in ("left", "right"):
        stream = recording.of_device(name).stream_with("actual_q")
        assert stream.stream.rate == 125.0
        assert np.ptp(stream["target_q"][:, 5]) > 0.2
        begins[name] = stream["target_q"][0, 0]
    assert begins["right"] - begins["left"] == pytest.approx(0.5)


@pytest.mark.by_hand
@pytest.mark.timeout(300)
@pytest.mark.parametrize("fault", ["client process killed", "client process hangs", "connections dropped"])
def test_a_run_waits_and_goes_on_where_it_may(tmp_path: Path, fault: str) -> None:
    outcome = suffer(fault, host(2), "cb3", True, tmp_path)
    assert outcome.exit_status == 0, outcome.reason
    assert outcome.path_goes_on is not None
    assert outcome.longest_hole < 2.0, "samples do not pass through the client"


@pytest.mark.by_hand
@pytest.mark.timeout(300)
def test_a_run_goes_on_with_a_controller_that_booted_again(tmp_path: Path) -> None:
    outcome = suffer("controller restarted", host(3), "cb3", True, tmp_path)
    assert outcome.exit_status == 0, outcome.reason
    assert outcome.path_goes_on is not None
    assert outcome.lost > 0


@pytest.mark.extended
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("fault", "said"),
    [("protective stop", "protective stop"), ("program stopped at the panel", "does not run any more")],
)
def test_nothing_goes_on_after_what_somebody_has_to_look_at(tmp_path: Path, fault: str, said: str) -> None:
    outcome = suffer(fault, host(4), "cb3", True, tmp_path)
    assert outcome.exit_status == 1
    assert said in outcome.reason
    assert outcome.path_goes_on is None
    assert outcome.at_rest is not None
