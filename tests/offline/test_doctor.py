"""The doctor: what it finds is so, what is broken is found, and each finding says what to do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from labhil.doctor import examine, machine, packages, probes
from labhil.doctor.finding import Finding, State


@pytest.mark.parametrize(
    ("requirement", "state", "said"),
    [
        ("numpy>=2.0", State.FINE, np.__version__),
        ("numpy<1.0,>=0.5", State.BROKEN, "expected <1.0"),
        ("numpy>=99; python_version > '3'", State.BROKEN, "expected >=99"),
        ("no-such-package-of-ours>=1.2", State.BROKEN, "is not installed (expected >=1.2)"),
        ("numpy", State.FINE, np.__version__),
    ],
)
def test_a_package_is_held_against_what_is_declared(requirement: str, state: State, said: str) -> None:
    finding, extra = packages.check_requirement(requirement)
    assert (finding.state, extra) == (state, "")
    assert said in finding.found
    assert ("pip install" in finding.advice) == (state is State.BROKEN)


def test_an_extra_that_is_missing_is_worth_a_note_and_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    declared = ["numpy>=2", "no-such-package-of-ours>=1 ; extra == 'field'", 'numpy ; extra == "arm"']
    monkeypatch.setattr(packages, "requires", lambda name: declared)
    found = {finding.subject: finding for finding in packages.check_packages()}
    assert found["extra field"].state is State.NOTE
    assert found["extra field"].advice == "pip install 'labhil[field]'"
    assert found["extra arm"].state is State.FINE
    assert found["packages"].found.startswith("1 as declared: numpy")


@pytest.mark.parametrize(
    "marker", ["sys_platform == 'moon'", "platform_machine == 'z80'", "python_version < '3.11'"]
)
def test_what_is_not_meant_for_this_machine_is_not_missed(
    marker: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    declared = ["numpy>=2", f"no-such-package-of-ours; ({marker}) and extra == 'ur5'"]
    monkeypatch.setattr(packages, "requires", lambda name: declared)
    assert "extra ur5" not in {finding.subject for finding in packages.check_packages()}


def test_a_folder_that_cannot_be_written_is_found(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (bad,) = machine.check_disk(tmp_path / "file")
    assert (bad.state, "Not a directory" in bad.found) == (State.BROKEN, True)
    (good,) = machine.check_disk(tmp_path)
    assert good.state is not State.BROKEN
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_port_without_permission_is_found_with_the_group_to_join(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from serial.tools.list_ports_common import ListPortInfo

    port = tmp_path / "ttyACM0"
    port.write_text("")
    port.chmod(0o660)
    os.chown(port, -1, 20) if os.geteuid() == 0 else None
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [ListPortInfo(str(port))])
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    (finding,) = machine.check_serial()
    assert finding.state is State.BROKEN
    assert "usermod -aG" in finding.advice or "udev rule" in finding.advice


def test_the_quick_checks_say_something_with_a_unit() -> None:
    found = [
        *machine.check_cores(),
        *machine.check_clock(),
        *machine.check_real_time(),
        *packages.check_python(),
    ]
    assert [finding.subject for finding in found] == ["cores", "clock", "real time", "python"]
    assert all(finding.found for finding in found)


def test_a_check_that_breaks_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down() -> list[Finding]:
        raise OSError("no /proc here")

    for name in (
        "check_python",
        "check_packages",
        "check_cores",
        "check_clock",
        "check_timer",
        "check_real_time",
    ):
        monkeypatch.setattr(examine, name, lambda: [])
    monkeypatch.setattr(examine, "check_probes", break_down)
    monkeypatch.setattr(examine, "check_serial", break_down)
    found = list(examine.examine(tmp_path))
    assert [finding.subject for finding in found if finding.state is State.BROKEN] == [
        "probes",
        "serial ports",
    ]
    assert "no /proc here" in found[0].found
    assert examine.to_json(found)["fine"] is False
    assert "→" in examine.format_finding(found[0])


def test_a_probe_that_crashes_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    finding = probes.run_probe("recording")
    assert finding.state is State.BROKEN
    assert finding.advice == probes.ADVICE["recording"]


@pytest.mark.extended
@pytest.mark.timeout(400)
def test_all_of_it_as_json() -> None:
    command = [sys.executable, "-P", "-m", "labhil", "doctor", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
    told = json.loads(done.stdout)
    subjects = {finding["subject"]: finding for finding in told["findings"]}
    assert {*probes.PROBES, "python", "packages", "cores", "clock", "timer", "disk", "real time"} <= set(
        subjects
    )
    for name in probes.PROBES:
        assert subjects[name]["state"] == "fine", subjects[name]
    assert done.returncode == (0 if told["fine"] else 1)
    assert all(finding["advice"] for finding in told["findings"] if finding["state"] == "broken")
