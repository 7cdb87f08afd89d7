"""The short check of a device, on simulated devices over their wires."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from patient_labhil import COMMAND, patient_config

from labhil.bus import latch
from labhil.device_check import small_step
from labhil.device_check.at_rest import findings_at_rest
from labhil.device_check.check import Check, check_device
from labhil.device_check.direction import findings_of_step, movements
from labhil.device_check.expected import implausible_sizes, simulated_answer
from labhil.device_check.report import DeviceCheck
from labhil.device_check.samples import Samples
from labhil.device_check.small_step import Answer, SmallStep, make_step, plan_steps
from labhil.doctor.examine import format_finding
from labhil.doctor.finding import Finding, State
from labhil.errors import CommandRefusedError, UsageError
from labhil.experiment import devices
from labhil.experiment.bench import Bench
from labhil.experiment.experiment import load_experiment
from labhil.experiment.new import write_new
from labhil.experiment.plan import DevicePlan, device_plan
from labhil.plugins import load_driver
from labhil.rig import load_rig
from labhil.rig_sections import Limit

MOTOR = load_driver("dc_motor").spec


def new(folder: Path, *arguments: str, stdin: int = subprocess.DEVNULL) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [*COMMAND, "new", *arguments],
        cwd=folder,
        stdin=stdin,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert "Traceback" not in done.stderr
    return done


def edit(path: Path, old: str, replacement: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, replacement), encoding="utf-8")


@pytest.fixture(scope="module", autouse=True)
def patience() -> Iterator[None]:
    """Hosts of this process wait longer for commands, as those of ``COMMAND`` do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(devices, "HostConfig", patient_config)
        yield


def loopback(number: int) -> str:
    """An address of this machine that other test runs on it do not use."""
    pid = os.getpid()
    return f"127.{1 + pid % 250}.{1 + pid // 250 % 250}.{number}"


def motor(folder: Path) -> tuple[Path, DevicePlan]:
    """The rig file of a new motor, and the plan of a simulated one that runs in real time."""
    rig, experiment = write_new("dc_motor", "twin", folder)
    edit(experiment, "twin = { speed = 5.0, ", "twin = { ")
    return rig, device_plan(load_experiment(experiment), "bench")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Samples, Answer, Path]]:
    """What a simulated motor sends at rest and in a step of a fifth of its range, and its rig file."""
    rig, plan = motor(tmp_path_factory.mktemp("motor"))
    with Bench(plan) as bench:
        bench.read(timeout=30.0)
        rest = Samples.of(Samples.received(bench).stream, bench.collect(1.0))
        (step,), _ = plan_steps(plan.spec, plan.rig, rest, 0.2)
        answer = make_step(bench, step)
        bench.received()
        time.sleep(0.5)
        assert bench.received()["voltage"][-1] == 0.0
    yield rest, answer, rig


def turned(samples: Samples, *names: str) -> Samples:
    """The samples with the signs of some columns turned."""
    values = samples.values.copy()
    for name in names:
        values[:, samples.stream.columns_of(name)] *= -1.0
    return replace(samples, values=values)


def findings(answer: Answer, rig: Path) -> dict[str, Finding]:
    loaded = load_rig(rig)
    moved = movements(answer, loaded.kind, simulated_answer(answer, loaded))
    return {finding.subject: finding for finding in findings_of_step(answer, moved)}


@pytest.mark.extended
def test_a_motor_that_is_right_answers_as_its_model_expects(measured: tuple[Samples, Answer, Path]) -> None:
    _, answer, rig = measured
    found = findings(answer, rig)
    assert {name: finding.state for name, finding in found.items()} == {
        "speed": State.FINE,
        "current": State.FINE,
        "angle": State.FINE,
    }
    assert "rises" in found["speed"].found and "as the model expects" in found["speed"].found
    assert "as the model expects" in found["current"].found
    assert "no direction" in found["angle"].found


@pytest.mark.extended
def test_a_turned_sensor_and_a_turned_drive_are_told_apart(measured: tuple[Samples, Answer, Path]) -> None:
    _, answer, rig = measured
    for names, told in (
        (("current",), "swap the leads of the sensor of current"),
        (("speed", "current"), "turn the sign of voltage"),
    ):
        wrong = replace(answer, before=turned(answer.before, *names), after=turned(answer.after, *names))
        found = findings(wrong, rig)
        assert {name for name, finding in found.items() if finding.state is State.BROKEN} == set(names)
        assert told in found["current"].advice
        assert "falls" in found["current"].found and "by the model it rises" in found["current"].found


@pytest.mark.extended
def test_a_sensor_that_is_stuck_while_others_move_is_a_fault(measured: tuple[Samples, Answer, Path]) -> None:
    _, answer, rig = measured

    def without_speed(samples: Samples) -> Samples:
        values = samples.values.copy()
        values[:, samples.stream.columns_of("speed")] = 0.0
        return replace(samples, values=values)

    stuck = replace(answer, before=without_speed(answer.before), after=without_speed(answer.after))
    found = findings(stuck, rig)["speed"]
    assert found.state is State.BROKEN
    assert "it never changed while current moved" in found.found


@pytest.mark.extended
def test_at_rest_limits_rates_and_commands_are_looked_at(measured: tuple[Samples, Answer, Path]) -> None:
    rest, _, path = measured
    rig = load_rig(path)
    assert all(finding.state is not State.BROKEN for finding in findings_at_rest(rest, MOTOR, rig))
    narrow = rig.model_copy(update={"limits": {"current": Limit(min=1.0, max=2.0)}})
    found = {finding.subject: finding for finding in findings_at_rest(rest, MOTOR, narrow)}
    assert found["current [A]"].state is State.BROKEN
    assert "left its limits, 1 to 2" in found["current [A]"].found
    slow = replace(rest, t=2.0 * rest.t)
    rate = next(findings_at_rest(slow, MOTOR, rig))
    assert rate.state is State.BROKEN
    assert rate.found.startswith("50 Hz seen in ")
    values = rest.values.copy()
    values[:, rest.stream.columns_of("voltage")] = 3.0
    driven = {f.subject: f for f in findings_at_rest(replace(rest, values=values), MOTOR, rig)}
    assert "expected voltage at its safe value 0, found 3" in driven["voltage [V]"].found
    values[5:8, rest.stream.columns_of("current")] = float("nan")
    gaps = {f.subject: f for f in findings_at_rest(replace(rest, values=values), MOTOR, rig)}
    assert f"3 of {len(rest)} samples are no numbers" in gaps["current [A]"].found


@pytest.mark.extended
def test_steps_stay_within_the_limits_and_commands_without_limits_get_none(
    measured: tuple[Samples, Answer, Path],
) -> None:
    rest, _, path = measured
    rig = load_rig(path)
    for limit, target in ((Limit(min=-2.0, max=2.0), 0.2), (Limit(min=-4.0, max=0.1), -0.205)):
        (step,), _ = plan_steps(MOTOR, rig.model_copy(update={"limits": {"voltage": limit}}), rest, 0.05)
        assert step.start == 0.0
        assert step.target == pytest.approx(target)
    unlimited = replace(MOTOR, ranges={})
    steps, (why,) = plan_steps(unlimited, rig.model_copy(update={"limits": {}}), rest, 0.05)
    assert not steps and "it has no limits" in why.found
    outside = rig.model_copy(update={"limits": {"voltage": Limit(min=1.0, max=2.0)}})
    steps, (why,) = plan_steps(MOTOR, outside, rest, 0.05)
    assert not steps and why.state is State.BROKEN


def test_a_position_in_millimetres_is_larger_than_such_a_rig() -> None:
    import labhil as lh
    from labhil.recording.reader import read_recording

    recording = Path(__file__).parents[2] / "recordings" / "ball_beam_identify.mcap"
    (stream,) = [s for s in read_recording(recording).streams if "ball_position" in s.stream.names()]
    samples = Samples(stream.stream, stream.t, stream.values)
    rig = lh.model("ball_beam").rig_file
    assert not list(implausible_sizes(samples, rig))
    values = samples.values.copy()
    values[:, samples.stream.columns_of("ball_position")] *= 1000.0
    (found,) = implausible_sizes(replace(samples, values=values), rig)
    assert found.subject == "ball_position"
    assert "in which unit" in found.advice


@pytest.mark.extended
@pytest.mark.parametrize(
    ("kind", "share", "told"),
    [
        ("ball_beam", 0.2, {"ball_position": "as the model expects"}),
        ("solenoid", 0.2, {"coil_current": "as commanded", "plunger_position": "as the model expects"}),
        ("ur5", 0.05, {f"actual_q_{j}": "as commanded" for j in range(6)}),
    ],
)
def test_the_whole_check_of_a_simulated_device(
    tmp_path: Path, kind: str, share: float, told: dict[str, str]
) -> None:
    _, experiment = write_new(kind, "twin", tmp_path)
    if kind == "ur5":
        edit(experiment, "twin = { ", f'twin = {{ host = "{loopback(95)}", ')
    done = new(tmp_path, kind, "--move", "--step", f"{100 * share:g}")
    assert done.returncode == 0, done.stdout + done.stderr
    for column, text in told.items():
        assert re.search(rf"^ok +{column}: .*{text}$", done.stdout, re.MULTILINE), done.stdout
    assert "FAIL" not in done.stdout
    assert "no fault was found" in done.stderr


def test_what_the_check_finds_of_each_channel_is_json(tmp_path: Path) -> None:
    write_new("dc_motor", "twin", tmp_path)
    done = new(tmp_path, "dc_motor", "--move", "--step", "20", "--json", "check.json")
    assert done.returncode == 0, done.stdout + done.stderr
    data = json.loads((tmp_path / "check.json").read_text(encoding="utf-8"))
    assert data["schema"] == "labhil.device_check/1"
    found = DeviceCheck.model_validate_json(json.dumps(data))
    assert [format_finding(finding) for finding in found.findings] == done.stdout.splitlines()[2:]
    assert (found.rig, found.driver, found.fine) == ("dc_motor", "dc_motor", True)
    assert found.sample_rate.stated == 100.0
    assert found.sample_rate.seen == pytest.approx(100.0, rel=0.05)
    channels = {channel.channel: channel for channel in found.channels}
    assert {name: channel.unit for name, channel in channels.items()} == {
        "speed": "rad/s", "current": "A", "angle": "rad", "voltage": "V"
    }  # fmt: skip
    current = channels["current"]
    assert [(limit.min, limit.max) for limit in current.limits] == [(-8.0, 8.0)]
    assert current.within_limits and current.stuck is False
    (column,) = current.columns
    assert column.min is not None and column.max is not None and -8.0 < column.min < column.max < 8.0
    assert channels["speed"].within_limits is None
    assert channels["voltage"].command and channels["voltage"].stuck is None
    (step,) = found.steps
    assert (step.command, step.start, step.target, step.unit) == ("voltage", 0.0, pytest.approx(4.8), "V")
    motions = {motion.column: motion for motion in step.motions}
    assert (motions["speed"].direction, motions["speed"].expected) == ("rises", "rises")
    assert motions["speed"].expected_by == "model" and motions["speed"].agrees
    assert (motions["angle"].expected, motions["angle"].agrees) == (None, None)


@pytest.mark.extended
def test_json_on_stdout_is_alone_there_and_needs_a_check(tmp_path: Path) -> None:
    rig, _ = write_new("dc_motor", "twin", tmp_path)
    edit(rig, "current = { min = -8.0, max = 8.0 }", "current = { min = 1.0, max = 8.0 }")
    done = new(tmp_path, "dc_motor", "--json", "--check")
    assert done.returncode == 1
    found = DeviceCheck.model_validate(json.loads(done.stdout))
    channels = {channel.channel: channel for channel in found.channels}
    assert not found.fine and not found.steps
    assert channels["current"].within_limits is False
    assert "left its limits, 1 to 8" in channels["current"].violation
    other = tmp_path / "other"
    other.mkdir()
    without = new(other, "dc_motor", "--address", "twin", "--json")
    assert without.returncode == 2
    assert "expected --check or --move beside it" in without.stderr
    assert not list(other.iterdir())


@pytest.mark.extended
def test_without_a_yes_nothing_moves_and_the_files_are_used_again(tmp_path: Path) -> None:
    first = new(tmp_path, "dc_motor", "--address", "twin", "--check")
    assert first.returncode == 0
    assert "nothing was moved; --move makes these steps" in first.stderr
    assert "rises" not in first.stdout
    ours, theirs = pty.openpty()
    os.write(ours, b"n\n")
    again = new(tmp_path, "dc_motor", "--check", stdin=theirs)
    os.close(ours)
    os.close(theirs)
    assert again.returncode == 0
    assert "are used as they are" in again.stderr
    assert "Is everybody out of its way?" in again.stderr
    assert "rises" not in again.stdout
    other = new(tmp_path, "dc_motor", "--check", "--address", "/dev/ttyACM7")
    assert other.returncode == 2
    assert "expected the address /dev/ttyACM7, found twin" in other.stderr


@pytest.mark.extended
def test_a_fault_at_rest_keeps_the_device_from_being_moved(tmp_path: Path) -> None:
    rig, _ = write_new("dc_motor", "twin", tmp_path)
    edit(rig, "current = { min = -8.0, max = 8.0 }", "current = { min = 1.0, max = 8.0 }")
    done = new(tmp_path, "dc_motor", "--move")
    assert done.returncode == 1
    assert "FAIL  current [A]" in done.stdout
    assert "nothing was moved, as there are faults" in done.stdout


@pytest.mark.extended
def test_a_limit_that_trips_in_a_step_is_a_fault(tmp_path: Path) -> None:
    rig, experiment = write_new("dc_motor", "twin", tmp_path)
    edit(rig, "current = { min = -8.0, max = 8.0 }", "current = { min = -1.0, max = 1.0 }")
    told: list[Finding] = []
    assert not check_device(experiment, Check(told.append, lambda _steps: True, 0.3)).fine
    (fault,) = [finding for finding in told if finding.state is State.BROKEN]
    assert "left its limits, -1 to 1" in fault.found
    assert "brought to its safe state" in fault.advice


@pytest.mark.extended
def test_the_emergency_stop_is_heard_before_and_in_a_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    _, experiment = write_new("dc_motor", "twin", tmp_path / "bench")
    told: list[Finding] = []
    monkeypatch.setattr(small_step, "HOLD_TIME", 1.0)

    def press_later(steps: object) -> bool:
        threading.Timer(1.2, latch.press, ("somebody", "a test")).start()
        return True

    assert not check_device(experiment, Check(told.append, press_later, 0.05)).fine
    (fault,) = [finding for finding in told if finding.state is State.BROKEN]
    assert "emergency stop" in fault.found
    assert latch.release()
    with pytest.raises(CommandRefusedError, match="labhil estop --release"):
        check_device(experiment, Check(told.append, lambda _steps: bool(latch.press("test", "a test")), 0.05))


@pytest.mark.extended
def test_ctrl_c_in_a_step_brings_the_device_to_its_safe_value(tmp_path: Path) -> None:
    _, plan = motor(tmp_path)
    step = SmallStep(plan.spec.commands[0], "voltage", 0.0, 2.0, small_step.RAMP_TIME)
    with Bench(plan) as bench:
        bench.read(timeout=30.0)
        # in the middle of the hold at the start, or on the way, or at the target
        interrupt = threading.Timer(1.6, signal.pthread_kill, (threading.get_ident(), signal.SIGINT))
        interrupt.start()
        with pytest.raises(KeyboardInterrupt):
            while True:
                make_step(bench, step)
        bench.received()
        time.sleep(1.0)
        assert bench.received()["voltage"][-1] == 0.0


@pytest.mark.extended
def test_ctrl_c_ends_the_command_with_its_own_status(tmp_path: Path) -> None:
    write_new("dc_motor", "twin", tmp_path)
    process = subprocess.Popen(
        [*COMMAND, "new", "dc_motor", "--move", "--step", "20"],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    while "voltage from 0 to" not in (line := process.stderr.readline()):
        assert line, "the check ended before its step"
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=60)
    assert process.returncode == 130, out + error
    assert "Traceback" not in error
    assert "rises" not in out


def test_a_file_of_several_devices_is_refused() -> None:
    from importlib.resources import files

    path = Path(str(files("labhil.experiment") / "examples" / "three_rigs.toml"))
    with pytest.raises(UsageError, match="expected one device to check, found beam, coil, motor"):
        check_device(path, Check(lambda _finding: None, lambda _steps: False, 0.05))
