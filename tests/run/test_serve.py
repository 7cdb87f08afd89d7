"""The service of a lab, from its own process: devices up, recordings that roll, results beside them."""

from __future__ import annotations

import json
import signal
import subprocess
import threading
import time
from pathlib import Path

import psutil
import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.bus.ask import ask
from labhil.bus.keys import command_key
from labhil.bus.register import find_run
from labhil.bus.session import open_bus
from labhil.errors import ExperimentFileError, UsageError
from labhil.experiment.device_sections import TwinSection, parse_devices
from labhil.experiment.lab import Lab, load_lab
from labhil.experiment.lab_service import LabService
from labhil.experiment.twins import start_twin
from labhil.recording.reader import read_recording

RIG = Path(__file__).parents[2] / "labhil" / "experiment" / "examples" / "ball_beam.toml"
PLUGIN = 'plugin = "ball_beam"\nrig = "ball_beam.toml"\n'
BENCH = f'[devices.bench]\n{PLUGIN}address = "twin"\ntwin = {{ speed = 2.0 }}\n'
LOST = f'[devices.lost]\n{PLUGIN}address = "/dev/not-there"\n'
PATIENCE = 90.0


def begin(folder: Path, text: str) -> subprocess.Popen[str]:
    (folder / "lab.toml").write_text(text)
    (folder / "ball_beam.toml").write_text(RIG.read_text())
    command = [*PATIENT_LABHIL, "serve", "--config", "lab.toml"]
    with (folder / "said.txt").open("w") as said:
        return subprocess.Popen(command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=said)


def is_of(process: psutil.Process, folder: Path) -> bool:
    """Whether a process works in this folder, or was started for it."""
    try:
        return str(folder) in " ".join([process.cwd(), *process.cmdline()])
    except psutil.Error:
        return False


def wait_for(condition, what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.1)


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_a_lab_records_and_analyses_and_leaves_nothing_behind(tmp_path: Path) -> None:
    service = begin(tmp_path, f"[lab]\nroll = 6.0\n{BENCH}{LOST}")
    try:
        assert service.stdout is not None
        endpoint = service.stdout.readline().strip()
        said = tmp_path / "said.txt"
        wait_for(lambda: "bench: ball_beam at" in said.read_text(), "the bench")
        wait_for(lambda: "lost:" in said.read_text(), "the other one to be told")
        with open_bus(endpoint) as bus:
            assert ask(bus, command_key("bench", "status"), {})["state"] == "idle"
        wait_for(lambda: list(tmp_path.glob("*.diagnosis.json")), "a diagnosis")
    finally:
        service.send_signal(signal.SIGINT)
        status = service.wait(PATIENCE)
        service.stdout.close()
    assert status == 1  # one device was not there
    assert not list(tmp_path.glob("*.part"))
    recordings = sorted(tmp_path.glob("*.mcap"))
    assert len(recordings) >= 2
    for path in recordings:
        found = read_recording(path)
        assert found.rig is not None
        assert not found.damage
    result = json.loads(next(iter(sorted(tmp_path.glob("*.diagnosis.json")))).read_text())
    assert result["schema"] == "labhil.diagnosis/1"
    assert result["verdict"] == "not_decidable"  # nobody moved anything
    assert not [process for process in psutil.process_iter() if is_of(process, tmp_path)]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[lab]\nrol = 3.0\n", "rol"),
        ("[lab]\nroll = 0.1\n", "roll"),
        ('[lab]\nanalyse = ["guess"]\n', "expected fit or diagnose, found 'guess'"),
        ('[devices.run]\nplugin = "ball_beam"\naddress = "twin"\n', "run"),
        ("[lab\n", "not TOML"),
    ],
)
def test_what_is_wrong_with_a_lab_file_is_named(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(text)
    with pytest.raises(ExperimentFileError, match=told) as refused:
        load_lab(path)
    assert str(path) in str(refused.value)


@pytest.mark.extended
def test_a_device_that_comes_late_is_looked_for_and_status_says_so(tmp_path: Path) -> None:
    (tmp_path / "ball_beam.toml").write_text(RIG.read_text())
    address = tmp_path / "ttyLATE"
    text = f'[lab]\nname = "late"\n[devices.bench]\n{PLUGIN}address = "{address}"\nreconnect = true\n'
    lab = parse_devices(text, tmp_path / "lab.toml", Lab)
    said: list[str] = []
    over = threading.Event()
    twin = None
    with open_bus() as bus:
        service = LabService(lab, bus, tmp_path, said.append)
        serving = threading.Thread(target=service.run, args=(over.is_set,))
        serving.start()
        try:
            wait_for(lambda: any("the search goes on" in line for line in said), "the search")
            with pytest.raises(UsageError, match="found only a served lab"):
                find_run()
            with open_bus(find_run(or_lab=True)) as other:
                status = ask(other, command_key("@run", "status"), patience=5.0)
                assert (status["state"], status["devices"], status["up"]) == ("serving", ["bench"], [])
                assert "ttyLATE" in status["absent"]["bench"]
                twin, real = start_twin("bench", "ball_beam", TwinSection(), tmp_path / "t.json", over.is_set)
                address.symlink_to(real)
                wait_for(lambda: any(line.endswith("is up") for line in said), "the device")
                assert ask(other, command_key("bench", "status"), patience=5.0)["state"] == "idle"
                assert ask(other, command_key("@run", "status"))["up"] == ["bench"]
        finally:
            over.set()
            serving.join(PATIENCE)
            if twin is not None:
                twin.stop()
    assert service.failed == {}
    assert said[-1].startswith("recorded ")
