"""What the worker of a lab does with each kind of rig, and that one bad recording stops nothing."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.bus.session import open_bus
from labhil.campaign.policies import Policies, check_policies
from labhil.campaign.result_log import RESULT_LOG, unstudied_recordings
from labhil.campaign.studies.study import Task
from labhil.campaign.worker import Worker
from labhil.errors import ExperimentFileError, RecordingError
from labhil.experiment.lab import load_lab
from labhil.recording.metadata import read_rig_kinds
from labhil.recording.rig_attachments import rig_attachments
from labhil.recording.writer import RecordingWriter
from labhil.rig import parse_rig
from labhil.signals import Batch, Direction, Signal, Stream
from labhil.version import __version__

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "recordings" / "ball_beam_identify.mcap"
FIT = ROOT / "examples" / "fit.json"
PATIENCE = 240.0


def lab_file(folder: Path, text: str) -> Path:
    path = folder / "lab.toml"
    path.write_text(text, encoding="utf-8")
    return path


def entries(folder: Path) -> list[dict[str, Any]]:
    log = folder / RESULT_LOG
    return [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []


def two_rigs(folder: Path) -> Path:
    """A recording of a motor, whose rig file stands as that of the first device, and of a ball and beam."""
    path = folder / "two.mcap"
    stamps = np.arange(100) * 10_000_000
    attached: dict[str, bytes] = {}
    for device, kind in ((None, "dc_motor"), ("beam", "ball_beam")):
        attached |= rig_attachments(parse_rig(f'[rig]\nkind = "{kind}"\n', folder / "rig.toml"), device)
    with RecordingWriter(path) as writer:
        for name, data in attached.items():
            writer.attach(name, "application/toml", data)
        for device in ("motor", "beam"):
            stream = Stream("state", (Signal("x", "m", Direction.OUTPUT),), 100.0)
            channel = writer.add_stream(device, stream)
            writer.write(channel, Batch(np.arange(100), stamps, stamps, np.zeros((100, 1))))
    return path


def test_kinds_are_read_without_samples(tmp_path: Path) -> None:
    assert read_rig_kinds(SHIPPED) == {"bench": "ball_beam"}
    assert read_rig_kinds(two_rigs(tmp_path)) == {"motor": "dc_motor", "beam": "ball_beam"}
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(SHIPPED.read_bytes()[:5000])
    with pytest.raises(RecordingError, match=r"cut\.mcap"):
        read_rig_kinds(cut)


def test_each_device_gets_what_its_kind_of_rig_is_to_get(tmp_path: Path) -> None:
    text = """
[lab]
analyse = ["fit"]
[policies.ball_beam]
analyse = ["diagnose", "verify"]
baseline = ["viscous_friction", "coulomb_friction"]
model = "accepted.json"
seconds = 60.0
"""
    tasks = list(Policies.of_lab(load_lab(lab_file(tmp_path, text))).tasks(two_rigs(tmp_path)))
    told = [(task.kind, task.device, task.terms, task.model, task.seconds) for task in tasks]
    model = tmp_path / "accepted.json"
    assert told == [
        ("fit", "motor", None, None, None),
        ("diagnose", "beam", ("viscous_friction", "coulomb_friction"), model, 60.0),
        ("verify", "beam", None, model, None),
    ]
    assert [Task.from_json(json.loads(json.dumps(task.to_json()))) for task in tasks] == tasks


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[policies.see_saw]\n", "rig kind 'see_saw' does not exist"),
        ('[policies.ball_beam]\nanalyse = ["guess"]\n', "expected fit or diagnose or verify, found 'guess'"),
        ('[policies.ball_beam]\nanalyse = ["verify"]\n', "verify needs the accepted model"),
        ("[policies.ball_beam]\nterm = []\n", "term"),
        ("[policies.ball_beam]\nseconds = 0\n", "seconds"),
        ('[policies.ball_beam]\nmodel = "nowhere.json"\n', "expected a fit or a diagnosis"),
        ('[policies.dc_motor]\nmodel = "fit.json"\n', "expected a model of dc_motor, found one of ball_beam"),
    ],
)
def test_what_is_wrong_with_a_policy_is_named_before_anything_starts(
    text: str, told: str, tmp_path: Path
) -> None:
    shutil.copy(FIT, tmp_path / "fit.json")
    with pytest.raises(ExperimentFileError, match=told) as refused:
        check_policies(load_lab(lab_file(tmp_path, text)))
    assert "lab.toml" in str(refused.value)


@pytest.mark.extended
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('terms = ["viscous_frction"]', "did you mean 'viscous_friction'"),
        ('estimator = "luck"', "unknown estimator 'luck'"),
    ],
)
def test_names_that_the_kind_of_rig_does_not_have_are_refused(text: str, told: str, tmp_path: Path) -> None:
    path = lab_file(tmp_path, f"[policies.ball_beam]\n{text}\n")
    with pytest.raises(ExperimentFileError, match=told):
        check_policies(load_lab(path))


@pytest.mark.extended
def test_a_recording_that_cannot_be_read_and_a_study_that_does_not_end_stop_nothing(tmp_path: Path) -> None:
    said: list[str] = []
    with open_bus() as bus:
        # no fit of this recording is done within a hundredth of a second
        worker = Worker(
            tmp_path,
            Policies.of_lab(load_lab(lab_file(tmp_path, ""))).tasks,
            bus,
            said.append,
            time_limit=0.01,
        )
        try:
            (tmp_path / "a_bad.mcap").write_bytes(b"no recording at all")
            shutil.copyfile(SHIPPED, tmp_path / "b_good.mcap")
            deadline = time.monotonic() + PATIENCE
            while len(entries(tmp_path)) < 3 and time.monotonic() < deadline:
                worker.poll()
                time.sleep(0.05)
        finally:
            worker.close()
    bad, fit, diagnosis = entries(tmp_path)
    assert (bad["recording"], bad["study"], bad["state"]) == ("a_bad.mcap", None, "failed")
    for entry in (fit, diagnosis):
        assert (entry["recording"], entry["state"], entry["result"]) == ("b_good.mcap", "cancelled", None)
        assert "ended by force" in entry["said"]
    assert any("a_bad.mcap: not studied" in line for line in said)


def test_what_came_while_no_worker_was_there_is_studied_and_nothing_older(tmp_path: Path) -> None:
    now = time.time()
    log = [
        {"time": datetime.fromtimestamp(now - 100.0, UTC).isoformat(), "recording": "done.mcap"},
        {"time": "never", "recording": "c.mcap"},
        ["nonsense"],
    ]
    (tmp_path / RESULT_LOG).write_text("".join(json.dumps(line) + "\n" for line in log) + '{"half\n')
    for name, age in (("old", 200.0), ("done", 150.0), ("missed", 50.0), ("late", 60.0)):
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(b"no recording at all")
        os.utime(path, (now - age, now - age))
    said: list[str] = []
    with open_bus() as bus:
        worker = Worker(tmp_path, Policies.of_lab(load_lab(lab_file(tmp_path, ""))).tasks, bus, said.append)
        worker.poll()
        worker.close()
        again = Worker(tmp_path, Policies.of_lab(load_lab(lab_file(tmp_path, ""))).tasks, bus, said.append)
        again.poll()
        again.close()
    assert said[0] == "recorded while nobody studied what came in, so now: late.mcap, missed.mcap"
    assert [line.partition(":")[0] for line in said[1:]] == ["late.mcap", "missed.mcap"]


def test_in_a_folder_where_no_worker_ever_was_nothing_is_left_behind(tmp_path: Path) -> None:
    shutil.copyfile(SHIPPED, tmp_path / "old.mcap")
    assert unstudied_recordings(tmp_path) == []


@pytest.mark.extended
@pytest.mark.timeout(600)
def test_a_served_folder_is_studied_by_its_policy_and_catalogued(tmp_path: Path) -> None:
    text = """
[lab]
record = false
[policies.ball_beam]
analyse = ["fit", "verify"]
terms = ["viscous_friction", "coulomb_friction", "dead_zone"]
estimator = "nlse"
model = "accepted.json"
"""
    shutil.copy(FIT, tmp_path / "accepted.json")
    command = [*PATIENT_LABHIL, "serve", "--config", str(lab_file(tmp_path, text))]
    service = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert service.stdout is not None
        service.stdout.readline()
        shutil.copyfile(SHIPPED, tmp_path / "run.mcap")
        (tmp_path / "bad.mcap").write_bytes(SHIPPED.read_bytes()[:9000])
        deadline = time.monotonic() + PATIENCE
        while len(entries(tmp_path)) < 3:
            assert time.monotonic() < deadline, entries(tmp_path)
            time.sleep(0.2)
    finally:
        service.send_signal(signal.SIGINT)
        service.wait(PATIENCE)
        service.stdout.close()
    found = {(entry["recording"], entry["study"]): entry for entry in entries(tmp_path)}
    fit, verified = found["run.mcap", "fit"], found["run.mcap", "verify"]
    assert found["bad.mcap", None]["state"] == "failed"
    told = json.loads((tmp_path / fit["result"]).read_text())
    assert told["terms"] == ["viscous_friction", "coulomb_friction", "dead_zone"]
    assert told["estimator"] == "nlse"
    assert fit["versions"]["labhil"] == __version__
    assert fit["versions"]["numpy"] == np.__version__
    assert fit["sha256"] == told["recordings"][0]["sha256"]
    assert (
        verified["verdict"]
        == json.loads((tmp_path / verified["result"]).read_text())["verdict"]
        == "consistent"
    )
