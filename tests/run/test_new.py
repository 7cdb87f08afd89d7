from __future__ import annotations

import os
import pty
import subprocess
import sys
import time
from pathlib import Path

import pytest

from labhil.experiment.experiment import load_experiment
from labhil.experiment.new import example_drivers, write_new
from labhil.experiment.plan import make_plan
from labhil.rig import load_rig

COMMAND = (sys.executable, "-P", "-m", "labhil", "new")


def new(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [*COMMAND, *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in done.stderr
    return done


@pytest.mark.extended
@pytest.mark.parametrize("kind", example_drivers())
@pytest.mark.parametrize("address", ["twin", "192.168.1.9"])
def test_what_is_written_can_be_planned(tmp_path: Path, kind: str, address: str) -> None:
    rig, experiment = write_new(kind, address, tmp_path / "bench")
    plan = make_plan(load_experiment(experiment))
    (device,) = plan.devices
    assert device.section.address == address
    assert device.rig.limits
    assert address == "twin" or not load_rig(rig).known


@pytest.mark.extended
def test_the_command_writes_two_files_and_overwrites_none(tmp_path: Path) -> None:
    done = new(tmp_path, "dc_motor", "--address", "/dev/ttyACM0", "-o", "bench")
    assert done.stdout.split() == ["bench/dc_motor.toml", "bench/dc_motor_identify.toml"]
    assert 'address = "/dev/ttyACM0"' in (tmp_path / "bench" / "dc_motor_identify.toml").read_text()
    again = new(tmp_path, "dc_motor", "--address", "twin", "-o", "bench")
    assert again.returncode == 2
    assert "is there already" in again.stderr


@pytest.mark.extended
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("dc_moter", "--address", "twin"), "did you mean 'dc_motor'"),
        (("dc_motor", "--address", " "), 'expected "twin"'),
        (("dc_motor", "--address", "not an address"), "found 'not an address'"),
        ((), "KIND: expected it on the command line"),
        (("dc_motor",), "--address: expected it on the command line"),
        (("ur5", "--search", "10.0.0.0/8"), "--search: expected an IPv4 network of 254 hosts at most"),
        (("dc_motor", "--search", "192.168.1.0/24"), "which is on a serial port"),
        (("ur5", "--address", "twin", "--search", "192.168.1.0/24"), "expected no --address beside it"),
    ],
)
def test_what_is_missing_or_wrong_is_said(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    done = new(tmp_path, *arguments)
    assert done.returncode == 2
    assert message in done.stderr


def asked(folder: Path, answers: bytes) -> subprocess.CompletedProcess[str]:
    """The command at a terminal, where these answers are typed."""
    ours, theirs = pty.openpty()
    os.write(ours, answers)
    done = subprocess.run(
        COMMAND, cwd=folder, stdin=theirs, capture_output=True, text=True, check=False, timeout=60
    )
    os.close(ours)
    os.close(theirs)
    return done


def test_at_a_terminal_it_asks(tmp_path: Path) -> None:
    done = asked(tmp_path, b"solenoid\ntwin\nn\n")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["solenoid.toml", "solenoid_identify.toml"]
    assert "Read the device now" in done.stderr


@pytest.mark.extended
def test_the_question_says_what_the_driver_takes_and_a_wrong_kind_is_refused_before(tmp_path: Path) -> None:
    arm = asked(tmp_path, b"ur5\ntwin\nn\n")
    assert "IP address" in arm.stderr
    assert "serial port" not in arm.stderr
    assert 'address = "twin"' in (tmp_path / "ur5_identify.toml").read_text(encoding="utf-8")
    wrong = asked(tmp_path, b"ur55\n")
    assert wrong.returncode == 2
    assert "did you mean 'ur5'" in wrong.stderr
    assert "Its address" not in wrong.stderr


@pytest.mark.extended
@pytest.mark.parametrize(("typed", "status"), [(b"dc_motor\n\x03", 130), (b"dc_motor\n\x04", 2)])
def test_a_question_ends_with_ctrl_c_and_with_the_end_of_the_input(
    tmp_path: Path, typed: bytes, status: int
) -> None:
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        ["setsid", "--ctty", *COMMAND],
        cwd=tmp_path,
        stdin=theirs,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    assert process.stderr is not None
    said = b""
    os.write(ours, typed[:-1])
    while b"Its address" not in said:
        said += os.read(process.stderr.fileno(), 4096)
    time.sleep(0.5)  # the question is asked; now it is read
    os.write(ours, typed[-1:])
    assert process.wait(60) == status
    process.stderr.close()
    os.close(ours)
    os.close(theirs)
    assert not list(tmp_path.iterdir())
