"""Runs that wait for a signal, check before and after their steps, and call a function of somebody's own."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import labhil as lh
from labhil.bus import latch
from labhil.errors import ConditionError, EmergencyStopError, ExperimentFileError, HookError, RunStoppedError
from labhil.experiment.control import RunState
from labhil.experiment.controller import Controller
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.plan import make_plan
from labhil.experiment.run import Progress, RunControl, RunResult, run_experiment
from labhil.experiment.step_clock import StepClock
from labhil.plugins import load_driver
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from labhil.service.emergency import press_everywhere

PATIENCE = 60.0
TEXT = """
[experiment]
name = "patient"
HOOK
[devices.bench]
plugin = "dc_motor"
address = "twin"
twin = { speed = 4.0, seed = 3 }
CHECKS
[[steps]]
device = "bench"
signal = "voltage"
excitation = "hold"
level = 5.0
duration = 2.0
[[steps]]
device = "bench"
signal = "voltage"
excitation = "hold"
level = -1.0
duration = 1.0
WHEN
"""
STANDSTILL = 'when = "abs(speed) < 0.5"\nwait = 60.0'
NEVER = 'when = "speed > 1e6"\nwait = WAIT'


def text(*, hook: str = "", checks: str = "", when: str = "") -> str:
    return TEXT.replace("HOOK", hook).replace("CHECKS", checks).replace("WHEN", when)


def check(at: str, condition: str, more: str = "") -> str:
    return f'[[checks]]\nat = "{at}"\ncondition = "{condition}"\n{more}\n'


def run(folder: Path, written: str) -> tuple[RunResult, Recording]:
    result = run_experiment(parse_experiment(written, folder / "patient.toml"), folder)
    assert result.path is not None, result.reason
    return result, read_recording(result.path)


def messages(recording: Recording, kind: str) -> list[str]:
    return [str(event.body["message"]) for event in recording.events if event.body.get("kind") == kind]


def last_voltage(recording: Recording) -> float:
    return float(recording.stream_with("voltage")["voltage"][-1])


@pytest.fixture
def no_stop_stands() -> Iterator[None]:
    yield
    latch.release()


@pytest.mark.extended
def test_a_step_begins_when_its_condition_holds_and_lasts_as_long_as_it_says(tmp_path: Path) -> None:
    result, recording = run(tmp_path, text(when=STANDSTILL))
    assert result.error is None, result.reason
    waits, begins = messages(recording, "step")
    assert waits == "bench: steps.1 waits for abs(speed) < 0.5, at most 60 s"
    assert begins.startswith("bench: steps.1 began after ")
    assert begins.endswith(" s: abs(speed) < 0.5")
    asked = recording.stream_with("voltage_requested")
    data = recording.stream_with("speed", "voltage")
    back = asked.t[asked["voltage_requested"] == -1.0]
    speed = np.interp(back[0], data.t, data["speed"])
    assert abs(speed) < 1.0
    waited = float(begins.split()[4])
    assert waited > 0.0
    assert recording.duration > 3.0 + 0.9 * waited
    between = asked["voltage_requested"][(asked.t > back[0] - 0.5 * waited) & (asked.t < back[0])]
    assert np.all(between == 0.0), "the safe value while it waits"
    assert back[-1] - back[0] == pytest.approx(1.0, abs=0.1)


@pytest.mark.extended
def test_a_condition_that_never_holds_ends_the_run_safe_and_says_what_was_there(tmp_path: Path) -> None:
    result, recording = run(tmp_path, text(when=NEVER.replace("WAIT", "1.5")))
    assert isinstance(result.error, ConditionError)
    assert result.exit_status == 1
    assert result.reason.startswith("steps.1.when: expected speed > 1e6 within 1.5 s, found speed = ")
    assert last_voltage(recording) == 0.0
    assert result.reason in messages(recording, "failed")


class Waiting:
    """A run in a thread of its own that waits at its second step."""

    def __init__(self, folder: Path, written: str) -> None:
        self.experiment = parse_experiment(written, folder / "patient.toml")
        self.folder, self.control = folder, RunControl()
        self.result: RunResult | None = None
        self.stands_at = threading.Event()
        self._before = -1.0
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        self.result = run_experiment(self.experiment, self.folder, self._follow, self.control)

    def _follow(self, progress: Progress) -> None:
        if progress.elapsed == self._before == 2.0:
            self.stands_at.set()
        self._before = progress.elapsed

    def finish(self) -> tuple[RunResult, Recording]:
        self.thread.join(PATIENCE)
        assert self.result is not None and self.result.path is not None
        return self.result, read_recording(self.result.path)


@pytest.mark.extended
def test_the_emergency_stop_ends_a_run_that_waits(tmp_path: Path, no_stop_stands: None) -> None:
    waiting = Waiting(tmp_path, text(when=NEVER.replace("WAIT", "600.0")))
    assert waiting.stands_at.wait(PATIENCE)
    assert press_everywhere("a test", "while it waits").answered == {"bench": "latched"}
    result, recording = waiting.finish()
    assert isinstance(result.error, EmergencyStopError)
    assert last_voltage(recording) == 0.0


@pytest.mark.extended
def test_a_run_that_waits_can_be_paused_resumed_and_stopped(tmp_path: Path) -> None:
    waiting = Waiting(tmp_path, text(when=NEVER.replace("WAIT", "600.0")))
    assert waiting.stands_at.wait(PATIENCE)
    waiting.control.pause()
    assert waiting.control.wait_for(RunState.PAUSED, timeout=PATIENCE)
    waiting.control.resume()
    assert waiting.control.wait_for(RunState.RUNNING, timeout=PATIENCE)
    waiting.control.stop("enough")
    result, recording = waiting.finish()
    assert (result.error, result.reason) == (None, "enough")
    assert -1.0 not in recording.stream_with("voltage_requested")["voltage_requested"]


def test_what_keeps_the_plant_in_range_works_while_its_step_waits() -> None:
    written = """
[experiment]
name = "held"
[devices.bench]
plugin = "ball_beam"
address = "twin"
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "hold"
level = 0.4
stabilise = { on = "ball_position", kp = 7.0, setpoint = 0.02 }
when = "abs(ball_position) < 0.03"
wait = 10.0
duration = 5.0
"""
    stream = load_driver("ball_beam").spec.stream
    steps = parse_experiment(written, Path("held.toml")).schedule()
    clock, controller = StepClock(steps, stream.columns()), Controller(steps, stream, {"servo_angle": 0.0})
    place = stream.columns().index("ball_position")

    def at(t_ns: int, ball: float) -> float:
        values = [0.0] * len(stream.columns())
        values[place] = ball
        clock.advance(t_ns, values)
        return controller.setpoints(clock.elapsed, values, waiting=clock.is_waiting)["servo_angle"]

    clock.start(0)
    assert at(0, 0.12) == pytest.approx(-0.7)
    assert at(2_000_000_000, 0.12) == pytest.approx(-0.7)
    assert at(4_000_000_000, 0.02) == pytest.approx(0.4)
    assert clock.elapsed == 0.0
    assert at(5_000_000_000, 0.12) == pytest.approx(0.4 - 0.7)
    assert clock.elapsed == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("written", "message"),
    [
        (text(when='when = "sped < 1"\nwait = 1.0'), r"steps.1.when: signal 'sped' does not exist \(did you"),
        (text(when='when = "speed < 1"'), r"steps.1: expected `when` and `wait` \(s, at most\) together"),
        (text(when="when = 3\nwait = 1.0"), "steps.1.when: expected a condition like `speed < 0.1`, found 3"),
        (text(checks=check("before", "speed")), "checks.0.condition: expected a comparison"),
        (text(checks=check("before", "sped < 1")), "checks.0.condition: signal 'sped' does not exist"),
        (text(checks=check("during", "speed < 1")), "checks.0.at: .*before.*after"),
        (
            text(checks=check("after", "speed < 1", 'device = "bank"')),
            "checks.0.device: no device 'bank'; known: bench",
        ),
        (text(hook='hook = "tell"'), "experiment.hook: "),
    ],
)
def test_what_cannot_be_kept_is_refused_before_anything_moves(written: str, message: str) -> None:
    with pytest.raises(ExperimentFileError, match=message):
        make_plan(parse_experiment(written, Path("patient.toml")))


def test_a_plan_shows_what_is_waited_for_and_called() -> None:
    checks = check("before", "abs(speed) < 1") + check("after", "abs(speed) < 2", "within = 20.0")
    experiment = parse_experiment(
        text(hook='hook = "lab.py:tell"', checks=checks, when=STANDSTILL), Path("patient.toml")
    )
    plan = make_plan(experiment).describe()
    assert "begins once abs(speed) < 0.5, waits 60 s at most" in plan
    assert "check before the steps, within 5 s: abs(speed) < 1" in plan
    assert "check after the steps, within 20 s: abs(speed) < 2" in plan
    assert "calls lab.py:tell before and after" in plan
    again = parse_experiment(experiment.public_text(), Path("patient.toml"))
    assert (again.steps, again.checks) == (experiment.steps, experiment.checks)


@pytest.mark.extended
def test_a_check_that_fails_before_the_steps_moves_nothing(tmp_path: Path) -> None:
    written = text(checks=check("before", "speed > 3", 'within = 0.5\nmessage = "turn the wheel"'))
    result, recording = run(tmp_path, written)
    assert isinstance(result.error, ConditionError)
    assert "the check before the steps failed: turn the wheel" in result.reason
    assert "(expected speed > 3 within 0.5 s, found speed = " in result.reason
    assert np.all(recording.stream_with("voltage")["voltage"] == 0.0)


@pytest.mark.extended
@pytest.mark.parametrize(("condition", "is_good"), [("abs(speed) < 0.5", True), ("speed > 1e5", False)])
def test_a_check_after_the_steps_sees_the_device_in_its_safe_state(
    tmp_path: Path, condition: str, is_good: bool
) -> None:
    written = text(checks=check("after", condition, "within = 10.0" if is_good else "within = 0.5"))
    result, recording = run(tmp_path, written)
    assert last_voltage(recording) == 0.0
    if is_good:
        assert result.error is None, result.reason
        assert abs(recording.stream_with("speed")["speed"][-1]) < 1.0
    else:
        assert isinstance(result.error, ConditionError)
        assert "the check after the steps failed (expected speed > 1e5" in result.reason
        assert messages(recording, "failed") == [result.reason]


@pytest.mark.extended
def test_a_check_after_the_steps_ends_with_the_emergency_stop_too(
    tmp_path: Path, no_stop_stands: None
) -> None:
    written = text(checks=check("after", "speed > 1e5", "within = 600.0"))
    experiment = parse_experiment(written, tmp_path / "patient.toml")
    control = RunControl()
    results: list[RunResult] = []
    thread = threading.Thread(
        target=lambda: results.append(run_experiment(experiment, tmp_path, control=control))
    )
    thread.start()
    assert control.wait_for(RunState.STOPPING, timeout=PATIENCE), [result.reason for result in results]
    press_everywhere("a test", "while it checks")
    thread.join(PATIENCE)
    assert isinstance(results[0].error, EmergencyStopError), results[0].reason


HOOKS = """
import json, sys, time
from pathlib import Path

NOTES = Path(__file__).with_name("notes.jsonl")

def note(run):
    told = {"moment": run.moment, "name": run.name, "columns": sorted(run.values["bench"]),
            "reason": run.reason, "error": None if run.error is None else str(run.error),
            "recording": str(run.recording)}
    with NOTES.open("a") as file:
        file.write(json.dumps(told) + chr(10))

def fail_before(run):
    note(run)
    if run.moment == "before":
        raise RuntimeError("no oil in the [bold]gear[/bold]")

def fail_after(run):
    note(run)
    if run.moment == "after":
        sys.exit("no more oil")

def sleep(run):
    Path(__file__).with_name("asleep").touch()
    time.sleep(0.0 if run.moment == "after" else 5.0)

NUMBER = 3
"""


def notes_of(folder: Path) -> list[dict[str, object]]:
    lines = (folder / "notes.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines]


@pytest.mark.extended
def test_a_hook_is_called_before_and_after_with_what_the_run_knows(tmp_path: Path) -> None:
    (tmp_path / "lab.py").write_text(HOOKS, encoding="utf-8")
    result, _ = run(tmp_path, text(hook='hook = "lab.py:note"'))
    assert result.error is None, result.reason
    before, after = notes_of(tmp_path)
    assert (before["moment"], after["moment"]) == ("before", "after")
    assert (before["name"], before["reason"], after["reason"]) == ("patient", "", "all steps are done")
    assert {"speed", "voltage"} <= set(before["columns"])  # type: ignore[call-overload]
    assert after["recording"] == str(result.path)
    assert (before["error"], after["error"]) == (None, None)


@pytest.mark.extended
def test_a_hook_that_raises_before_the_steps_ends_the_run_before_anything_moves(tmp_path: Path) -> None:
    (tmp_path / "lab.py").write_text(HOOKS, encoding="utf-8")
    result, recording = run(tmp_path, text(hook='hook = "lab.py:fail_before"'))
    assert isinstance(result.error, HookError)
    assert np.all(recording.stream_with("voltage")["voltage"] == 0.0)
    assert result.reason == (
        "the hook lab.py:fail_before before the steps failed: RuntimeError: no oil in the [bold]gear[/bold]"
    )
    after = notes_of(tmp_path)[-1]
    assert (after["moment"], after["error"]) == ("after", result.reason), "it can switch off what it has on"


@pytest.mark.extended
def test_a_hook_that_raises_after_the_steps_fails_the_run_and_keeps_the_recording(tmp_path: Path) -> None:
    (tmp_path / "lab.py").write_text(HOOKS, encoding="utf-8")
    result, recording = run(tmp_path, text(hook='hook = "lab.py:fail_after"'))
    assert isinstance(result.error, HookError)
    assert result.reason == "the hook lab.py:fail_after after the steps failed: SystemExit: no more oil"
    assert last_voltage(recording) == 0.0
    assert messages(recording, "failed") == [result.reason]


@pytest.mark.extended
def test_a_run_can_be_aborted_while_its_hook_is_at_work(tmp_path: Path) -> None:
    (tmp_path / "lab.py").write_text(HOOKS, encoding="utf-8")
    experiment = parse_experiment(text(hook='hook = "lab.py:sleep"'), tmp_path / "patient.toml")
    control = RunControl()
    results: list[RunResult] = []
    thread = threading.Thread(
        target=lambda: results.append(run_experiment(experiment, tmp_path, control=control))
    )
    thread.start()
    waited = threading.Event()
    for _ in range(int(PATIENCE / 0.05)):
        if (tmp_path / "asleep").exists():
            break
        waited.wait(0.05)
    control.abort("that takes too long")
    thread.join(PATIENCE)
    assert isinstance(results[0].error, RunStoppedError)
    assert results[0].reason == "that takes too long"


def test_a_hook_that_is_not_there_is_refused_by_a_dry_run_too(tmp_path: Path) -> None:
    (tmp_path / "lab.py").write_text("")
    path = tmp_path / "patient.toml"
    path.write_text(text(hook='hook = "lab.py:none"'))
    with pytest.raises(ExperimentFileError, match=r"experiment\.hook: .*lab\.py: has no 'none'"):
        lh.Experiment.load(path).plan()


HOT = 'when = "winding_temperature < 100"\nwait = 5.0'


@pytest.mark.parametrize(
    ("stated", "place"),
    [
        (text(when=HOT), "steps.1.when"),
        (text(checks=check("before", "winding_temperature < 100")), "checks.0.condition"),
        (text(when='stabilise = { on = "winding_temperature", kp = 1.0 }'), "steps.1.stabilise.on"),
    ],
)
def test_a_condition_on_a_sensor_that_the_simulated_device_lacks_is_refused_by_a_plan(
    stated: str, place: str
) -> None:
    with pytest.raises(ExperimentFileError, match=f"{place}: .*set `temperature_sensor`, which is 0"):
        make_plan(parse_experiment(stated, Path("patient.toml")))
    fitted = stated.replace("seed = 3", "seed = 3, set = { temperature_sensor = 1 }")
    make_plan(parse_experiment(fitted, Path("patient.toml")))
    board = stated.replace('"twin"', '"/dev/ttyACM0"')
    make_plan(parse_experiment(board, Path("patient.toml")))


def test_a_step_beyond_both_is_answered_with_the_limit_of_the_rig_file(tmp_path: Path) -> None:
    (tmp_path / "motor.toml").write_text(
        '[rig]\nkind = "dc_motor"\n[limits]\nvoltage = { min = -6.0, max = 6.0 }\n'
    )
    stated = text().replace('address = "twin"', 'address = "twin"\nrig = "motor.toml"')
    beyond = parse_experiment(stated.replace("level = 5.0", "level = 50.0"), tmp_path / "patient.toml")
    with pytest.raises(ExperimentFileError, match=r"its limits are -6 to 6 V"):
        make_plan(beyond)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ("lab.py:nothing", "experiment.hook: .*lab.py: has no 'nothing'"),
        (
            "lab.py:NUMBER",
            "experiment.hook: expected 'lab.py:NUMBER' to be a function of one argument, found 3",
        ),
        ("nowhere.py:tell", "experiment.hook: expected the Python file"),
        ("no.such.module:tell", "experiment.hook: expected a module that can be imported"),
    ],
)
def test_a_hook_that_is_not_there_is_refused_before_anything_starts(
    tmp_path: Path, stated: str, message: str
) -> None:
    (tmp_path / "lab.py").write_text(HOOKS, encoding="utf-8")
    experiment = parse_experiment(text(hook=f'hook = "{stated}"'), tmp_path / "patient.toml")
    with pytest.raises(ExperimentFileError, match=message):
        run_experiment(experiment, tmp_path)
