"""Several recordings of one experiment file: what is swept, what is recorded of it, and how it goes on."""

from __future__ import annotations

import contextlib
import json
import random
import subprocess
from pathlib import Path
from typing import Any

import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.errors import ExperimentFileError, UsageError
from labhil.experiment.campaign import campaign_path, load_campaign, run_campaign
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.points import fingerprint, points_of
from labhil.experiment.run import run_experiment
from labhil.recording.reader import read_recording

RIG = '[rig]\nkind = "dc_motor"\n[limits]\nvoltage = { min = -6.0, max = 6.0 }\n'
TEXT = """
[experiment]
name = "levels"
operator = "Ada"
sample = "motor 7"
notes = "after lunch"
tags = ["cold", "new brushes"]
[devices.bench]
plugin = "dc_motor"
address = "twin"
rig = "rig.toml"
twin = { speed = 5.0, seed = 3 }
[[steps]]
device = "bench"
signal = "voltage"
excitation = "hold"
level = 3.0
duration = 1.0
[sweep]
[sweep.over]
"steps.0.level" = [2.0, 4.0]
"devices.bench.twin.seed" = [5, 6]
"""


def in_folder(folder: Path, text: str = TEXT) -> Any:
    (folder / "rig.toml").write_text(RIG)
    path = folder / "levels.toml"
    path.write_text(text)
    return parse_experiment(text, path)


def test_a_grid_runs_every_combination_and_a_list_one_of_each(tmp_path: Path) -> None:
    grid = points_of(in_folder(tmp_path))
    assert [tuple(point.settings.values()) for point in grid] == [(2.0, 5), (2.0, 6), (4.0, 5), (4.0, 6)]
    assert grid[2].experiment.steps[0].level == 4.0
    assert grid[1].experiment.devices["bench"].twin.seed == 6
    text = TEXT.replace("[sweep]", '[sweep]\nkind = "list"').replace(
        'name = "levels"', 'name = "x"\nrepeat = 2'
    )
    listed = points_of(in_folder(tmp_path, text))
    assert [(*point.settings.values(), point.repetition) for point in listed] == [
        (2.0, 5, 1),
        (2.0, 5, 2),
        (4.0, 6, 1),
        (4.0, 6, 2),
    ]
    assert listed[3].describe().startswith("run 4 of 4, steps.0.level = 4.0")
    assert {point.experiment.experiment.repeat for point in listed} == {1}


def test_what_a_twin_is_made_of_stays_out_of_a_recording(tmp_path: Path) -> None:
    point = points_of(in_folder(tmp_path))[0]
    assert point.public_settings() == {"steps.0.level": "2.0"}
    assert "seed = 5" not in point.experiment.public_text()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"steps.0.level"', '"steps.1.level"', r"sweep.over: no steps.1: expected a number from 0 to 0"),
        ('"steps.0.level"', '"stebs.0.level"', r"sweep.over: no stebs \(did you mean 'steps'\?\)"),
        ('"steps.0.level"', '"steps.0.levle"', r"steps.0.levle: unknown key \(did you mean 'level'\?\)"),
        ("[2.0, 4.0]", '[2.0, "much"]', r"with steps.0.level = \"much\".*found 'much'"),
    ],
)
def test_a_place_that_is_not_there_is_refused_before_anything_moves(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    experiment = in_folder(tmp_path, TEXT.replace(old, new))
    with pytest.raises(ExperimentFileError, match=message):
        points_of(experiment)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[2.0, 4.0]", "[]", "expected at least one value, found none"),
        ('"steps.0.level"', '"experiment.name"', "cannot be swept"),
        ("[sweep]", '[sweep]\nkind = "tree"', "sweep.kind"),
        ("[5, 6]\n", "[5, 6, 7]\n[sweep.x]\n", "sweep.x: unknown key"),
    ],
)
def test_a_wrong_sweep_says_what_was_expected(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ExperimentFileError, match=message):
        in_folder(tmp_path, TEXT.replace(old, new))


def test_a_value_beyond_the_limits_stops_the_campaign_before_it_begins(tmp_path: Path) -> None:
    experiment = in_folder(tmp_path, TEXT.replace("[2.0, 4.0]", "[2.0, 9.0]"))
    with pytest.raises(ExperimentFileError, match=r"reaches from 9 to 9 V; its limits are -6 to 6"):
        run_campaign(experiment, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_one_run_is_not_a_campaign(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="`labhil run` makes all of them"):
        run_experiment(in_folder(tmp_path), tmp_path)


def test_notes_may_change_within_a_campaign_and_steps_may_not(tmp_path: Path) -> None:
    first = in_folder(tmp_path)
    same = in_folder(tmp_path, TEXT.replace("after lunch", "before lunch"))
    other = in_folder(tmp_path, TEXT.replace("duration = 1.0", "duration = 1.5"))
    digests = [fingerprint(experiment, points_of(experiment)) for experiment in (first, same, other)]
    assert digests[0] == digests[1] != digests[2]
    (tmp_path / "rig.toml").write_text(RIG.replace("6.0 }", "5.0 }"))
    assert fingerprint(first, points_of(first)) != digests[0]


@pytest.mark.extended
@pytest.mark.timeout(240)
@pytest.mark.parametrize("kills", [1, pytest.param(2, marks=pytest.mark.extended)])
def test_a_campaign_killed_at_any_moment_goes_on_without_loss(tmp_path: Path, kills: int) -> None:
    experiment = in_folder(tmp_path)
    out = tmp_path / "out"
    path = campaign_path(experiment, out)
    command = [*PATIENT_LABHIL, "run", str(tmp_path / "levels.toml"), "--out", str(out)]
    moments, finished = random.Random(7), {}
    for _ in range(kills):
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(moments.uniform(5.0, 9.0))
            process.kill()  # SIGKILL; nothing where it has just ended
        if path.exists():
            finished |= {run.number: run.path for run in load_campaign(path).runs if run.status == "done"}
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    file = load_campaign(path)
    assert [run.status for run in file.runs] == ["done"] * 4
    paths = {run.number: run.path for run in file.runs}
    assert {number: paths[number] for number in finished} == finished  # not made again
    assert done.stdout.splitlines() == [str(out / str(paths[number])) for number in range(1, 5)]
    for number, point in enumerate(points_of(experiment), 1):
        recording = read_recording(out / str(paths[number]))
        assert recording.metadata["campaign"]["run"] == str(number)
        assert recording.stream_with("voltage")["voltage"].max() == point.experiment.steps[0].level
    told = recording.metadata["experiment"]
    assert (told["operator"], told["sample"], told["notes"]) == ("Ada", "motor 7", "after lunch")
    assert json.loads(told["tags"]) == ["cold", "new brushes"]
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "4 of 4 runs are done already" in again.stderr
    assert again.stdout == done.stdout
    (tmp_path / "levels.toml").write_text(TEXT.replace("duration = 1.0", "duration = 1.5"))
    other = subprocess.run(command, capture_output=True, text=True, check=False)
    assert other.returncode == 2
    assert "found that of another version" in other.stderr
