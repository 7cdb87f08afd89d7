"""Faults on purpose: emergency stop, interlocks, frozen hosts, devices that are lost and come back."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from patient_labhil import PATIENT_WATCHDOG

from labhil.bus import latch, register
from labhil.bus.keys import setpoint_key
from labhil.bus.publish import publish_command
from labhil.errors import CommandRefusedError, RigFileError, UsageError
from labhil.experiment.control import RunControl, RunState
from labhil.experiment.device_sections import TwinSection
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.run import Progress, RunResult, run_experiment
from labhil.experiment.twins import start_twin
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from labhil.rig import parse_rig
from labhil.rig_sections import Interlock, Limit
from labhil.service.emergency import press_everywhere, press_on, release_everywhere
from labhil.service.interlocks import Interlocks
from labhil.service.limits import SampleLimits
from labhil.service.messages import Setpoint
from labhil.signals import Batch, Direction, Signal, Stream

PATIENCE = 90.0
RIG = """
[rig]
kind = "ball_beam"
[limits]
servo_angle = { min = -1.2, max = 1.2, rate = 12.0 }
ball_position = { min = -0.3, max = 0.3 } # beyond the stops: a ball that a busy machine drops ends no run
"""
TERMS = 'terms = ["viscous_friction", "coulomb_friction"]'


def device(name: str, address: str = "twin", more: str = "", rig: str = "rig.toml", twin: str = "") -> str:
    return f"""
[devices.{name}]
plugin = "ball_beam"
address = "{address}"
rig = "{rig}"
twin = {{ speed = 5.0, seed = 3, {TERMS}{twin} }}
{more}
[[steps]]
device = "{name}"
signal = "servo_angle"
excitation = "chirp"
frequencies = [0.2, 0.4]
amplitude = 0.3
stabilise = {{ on = "ball_position", kp = 7.0, kd = 3.0 }}
at = 0.0
duration = DURATION
"""


class Held:
    """A run in a thread of its own, with its handle and what it told."""

    def __init__(self, directory: Path, devices: str, duration: float = 100.0, rig: str = RIG) -> None:
        (directory / "rig.toml").write_text(rig)
        text = '[experiment]\nname = "held"\n' + devices.replace("DURATION", repr(duration))
        self.experiment = parse_experiment(text, directory / "experiment.toml")
        self.directory = directory
        self.control = RunControl()
        self.told: list[Progress] = []
        self.result: RunResult | None = None
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        self.result = run_experiment(self.experiment, self.directory, self.told.append, self.control)

    def wait_for(self, state: RunState, elapsed: float = 0.0) -> None:
        assert self.control.wait_for(state, timeout=PATIENCE), self.control.reason
        wait_until(lambda: bool(self.told) and self.told[-1].elapsed >= elapsed, f"not {elapsed} s far")

    def finish(self) -> tuple[RunResult, Recording]:
        self.thread.join(PATIENCE)
        assert self.result is not None and self.result.path is not None, self.result
        return self.result, read_recording(self.result.path)


def wait_until(condition: Callable[[], bool], otherwise: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, otherwise
        time.sleep(0.02)


def events(recording: Recording, name: str) -> list[tuple[str, str]]:
    found = [e for e in recording.events if (e.device, e.topic) == (name, "event")]
    return [(e.body["kind"], e.body["message"]) for e in found]


def kinds(recording: Recording, name: str) -> list[str]:
    return [kind for kind, _ in events(recording, name)]


@pytest.fixture
def hold(tmp_path: Path) -> Iterator[Callable[..., Held]]:
    runs: list[Held] = []

    def start(devices: str, duration: float = 100.0, rig: str = RIG) -> Held:
        runs.append(Held(tmp_path, devices, duration, rig))
        return runs[-1]

    yield start
    for run in runs:
        if run.thread.is_alive():
            run.control.abort("the test is over")
            run.thread.join(PATIENCE)


@pytest.fixture(autouse=True)
def no_stop_stands() -> Iterator[None]:
    yield
    latch.release()


def labhil(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "labhil", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=240)


# the emergency stop


@pytest.mark.extended
def test_the_emergency_stop_ends_a_run_and_stands_until_it_is_released(hold: Callable[..., Held]) -> None:
    run = hold(device("bench") + device("other"))
    run.wait_for(RunState.RUNNING, elapsed=0.5)
    done = labhil("estop", "--reason", "the ball jumped", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["answered"] == {"bench": "latched", "other": "latched"}
    assert "latched" in done.stderr
    result, recording = run.finish()
    assert result.exit_status == 1
    assert "emergency stop" in result.reason and "the ball jumped" in result.reason
    for name in ("bench", "other"):
        assert "estop" in kinds(recording, name)
    with pytest.raises(
        CommandRefusedError, match=r"the ball jumped; release it with `labhil estop --release`"
    ):
        run_experiment(run.experiment, run.directory)
    assert labhil("estop", "--release").returncode == 0
    assert latch.read_latch() is None


def test_the_stop_latches_in_the_host_and_works_by_file_alone(bench: Any) -> None:
    bench.take_lease()
    bench.set(0.2)
    latch.press("a test", "the bus is not needed")
    event = bench.wait_for_event("estop")
    assert "the bus is not needed" in event["message"]
    assert bench.ask("status")["applied"] == {"servo_angle": 0.0}
    latch.latch_path().unlink()
    for attempt in (bench.take_lease, lambda: bench.set(0.1), lambda: bench.ask("safe")):
        if attempt == bench.take_lease:
            with pytest.raises(CommandRefusedError, match="emergency stop by a test"):
                attempt()
    assert bench.ask("status")["state"] == "latched"
    assert bench.ask("estop", action="release") == {"state": "idle", "latched": False}
    bench.take_lease()
    bench.set(0.1)
    with pytest.raises(CommandRefusedError, match="action: expected"):
        bench.ask("estop", action="perhaps")


@pytest.mark.extended
def test_a_frozen_host_is_named_and_the_others_stop(bench: Any) -> None:
    os.kill(bench.host.pid, signal.SIGSTOP)
    try:
        outcome = press_everywhere("a test", "one is frozen")
    finally:
        os.kill(bench.host.pid, signal.SIGCONT)
    assert outcome.silent == ("bench",)
    assert not outcome.complete
    # thawed, it finds the latch by itself, and answers
    wait_until(lambda: press_everywhere("a test", "again").complete, "the host did not come back")
    wait_until(lambda: dict(release_everywhere().answered) == {"bench": "idle"}, "it was not released")


@pytest.mark.extended
def test_an_emergency_stop_without_devices_says_so() -> None:
    done = labhil("estop")
    assert done.returncode == 1
    assert "no device was found to stop" in done.stderr
    assert latch.read_latch() is not None
    assert labhil("estop", "--connect", "tcp/10.0.0.1:7447").returncode == 2


def test_devices_stop_even_where_the_latch_cannot_be_written(bench: Any) -> None:
    bench.take_lease()
    bench.set(0.2)
    blocked = latch.latch_path().with_suffix(f".{os.getpid()}.draft")
    blocked.mkdir()
    try:
        outcome = press_on(bench.bus, "a test", "a full disk", ["bench"])
    finally:
        blocked.rmdir()
    assert dict(outcome.answered) == {"bench": "latched"}
    assert "expected to write" in outcome.failed["the latch"] and not outcome.complete
    assert bench.ask("status")["applied"] == {"servo_angle": 0.0}


# control from outside


@pytest.mark.extended
def test_a_run_is_controlled_over_the_bus(hold: Callable[..., Held]) -> None:
    run = hold(device("bench"))
    run.wait_for(RunState.RUNNING, elapsed=0.5)
    status = json.loads(labhil("control", "status").stdout)
    assert (status["state"], status["name"], status["devices"]) == ("running", "held", ["bench"])
    paused = labhil("control", "pause", "--reason", "by hand")
    assert (json.loads(paused.stdout)["state"], run.control.state) == ("paused", RunState.PAUSED)
    refused = labhil("control", "pause")
    assert refused.returncode == 2
    assert "a run that is paused cannot be paused" in refused.stderr
    assert json.loads(labhil("control", "resume").stdout)["state"] == "running"
    labhil("control", "stop", "--reason", "enough")
    result, _ = run.finish()
    assert (result.exit_status, result.reason) == (0, "enough")
    nobody = labhil("control", "status")
    assert nobody.returncode == 2
    assert "found none" in nobody.stderr


def test_what_a_killed_process_left_in_the_register_is_swept() -> None:
    directory = register.runtime_directory()
    assert directory.stat().st_mode & 0o077 == 0
    with register.register("run", "mine", "tcp/127.0.0.1:1", ["bench"]):
        (mine,) = register.registered_processes("run")
        entry = {"kind": "run", "name": "dead", "endpoint": "tcp/127.0.0.1:2", "devices": [], "since": 0.0}
        dead = {**entry, "pid": os.getpid(), "birth": "another process of this number"}
        away = {**entry, "pid": os.getpid(), "birth": mine.birth, "endpoint": "tcp/10.0.0.1:2"}
        (directory / "1-0.json").write_text(json.dumps(dead))
        (directory / "1-1.json").write_text(json.dumps(away))
        (directory / "1-2.json").write_text("{")
        assert register.registered_processes("run") == (mine,)
        assert register.find_run() == mine.endpoint
    assert list(directory.glob("*.json")) == []
    with pytest.raises(UsageError, match="found none"):
        register.find_run()


# one device does not keep another from stopping


@pytest.mark.extended
def test_a_frozen_host_does_not_keep_another_device_from_stopping(hold: Callable[..., Held]) -> None:
    run = hold(device("bench") + device("other"))
    run.wait_for(RunState.RUNNING, elapsed=0.5)
    hosts = [p for p in psutil.Process().children() if "labhil.service.host" in p.cmdline()]
    frozen = hosts[0]
    frozen.suspend()
    run.control.abort("one of them hangs")
    result, recording = run.finish()
    assert result.exit_status == 1
    aborted, safe = (
        next(e.t_ns for e in recording.events if (e.device, e.body.get("kind")) == found)
        for found in (("run", "aborting"), ("other", "safe"))
    )
    assert (safe - aborted) * 1e-9 < 1.0
    assert not psutil.pid_exists(frozen.pid)


# interlocks

STREAM = Stream("state", (Signal("ball_position", "m", Direction.OUTPUT),), 100.0)


def samples(*values: float) -> Batch:
    return Batch.of([(i, i, i, [value]) for i, value in enumerate(values)], 1)


def test_an_interlock_trips_at_one_threshold_and_is_lifted_at_another() -> None:
    lock = Interlock(trip_above=0.2, resume_below=0.15)
    locks = Interlocks(STREAM, {"ball_position": lock})
    assert "has not been seen" in str(locks.standing())
    # between the thresholds at the start: nobody knows what it was before
    assert locks.take_in(samples(0.17)) is None
    assert "0.17 stands where it may not" in str(locks.standing())
    assert locks.take_in(samples(0.1, 0.17)) is None
    assert locks.standing() is not None
    assert locks.take_in(samples(0.1)) is None
    assert locks.standing() is None
    assert locks.take_in(samples(0.19)) is None
    assert locks.standing() is None
    tripped = locks.take_in(samples(0.1, 0.21, 0.19))
    assert tripped is not None and "ball_position = 0.21 tripped" in tripped.message
    assert locks.take_in(samples(0.3)) is None  # said once
    assert "0.21 tripped" in str(locks.standing())
    locks.take_in(samples(0.14))
    assert locks.standing() is None
    assert locks.take_in(samples(float("nan"))) is not None


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("ball_position = { resume_below = 0.1 }", "nothing would trip"),
        (
            "ball_position = { trip_above = 0.1, resume_below = 0.2 }",
            "needs a trip_above that is not smaller",
        ),
        ("ball_position = { trip_above = 0.1, resume_above = 0.0 }", "needs a trip_below"),
        ("ball_position = { trip_above = 0.1, trip_below = 0.2 }", "nothing to resume at"),
        ("ball_positon = { trip_above = 0.1 }", "did you mean 'ball_position'"),
        ("ball_position = { trip_over = 0.1 }", "did you mean 'trip_above'"),
        ("ball_position = { trip_above = nan }", "finite"),
    ],
)
def test_an_interlock_that_makes_no_sense_is_bad_input(line: str, message: str) -> None:
    with pytest.raises(RigFileError, match=message):
        parse_rig(f'[rig]\nkind = "ball_beam"\n[interlocks]\n{line}\n', Path("rig.toml"))


@pytest.mark.extended
def test_a_run_waits_at_an_interlock_and_does_not_start_while_it_stands(hold: Callable[..., Held]) -> None:
    rig = (
        f"{RIG}[interlocks]\nball_position = {{ trip_above = 0.006, resume_below = -0.3, then = 'pause' }}\n"
    )
    run = hold(device("bench", twin=", set = { start_position = 0.01 }"), rig=rig)
    run.thread.join(PATIENCE)
    assert run.result is not None
    assert run.result.exit_status == 2
    assert "ball_position" in run.result.reason and "stands where it may not" in run.result.reason

    rig = rig.replace("resume_below = -0.3", "resume_below = 0.005")
    run = hold(device("bench"), rig=rig)
    run.wait_for(RunState.PAUSED)
    assert "interlock: ball_position" in run.control.reason
    run.control.abort("seen")
    _, recording = run.finish()
    assert "interlock" in kinds(recording, "bench")


# a device that is lost


@pytest.mark.extended
def test_a_device_that_boots_again_is_taken_back_where_that_is_allowed(hold: Callable[..., Held]) -> None:
    run = hold(
        device("bench", more="reconnect = true", twin=", set = { fault_reset_at = 2.0 }"), duration=5.0
    )
    result, recording = run.finish()
    assert result.exit_status == 0, result.reason
    assert kinds(recording, "run") == [
        "starting", "running", "paused", "running", "stopping", "finished",
    ]  # fmt: skip
    back = dict(events(recording, "bench"))["reconnected"]
    assert "its configuration sent again: it has booted again" in back
    state = recording.stream_with("ball_position", "servo_angle")
    assert state.lost > 10
    assert (np.diff(state.t_hw_ns) > 0).all() and state.clock.device_clock
    assert (np.diff(state.seq) > 0).all()


@pytest.fixture
def link(tmp_path: Path) -> Iterator[Callable[[], Any]]:
    """Return what starts a twin behind the same name; whoever opens the name gets the newest one."""
    name, registered_processes = tmp_path / "ttyBENCH", []

    def start() -> Any:
        section = TwinSection(speed=2.0, seed=1)
        twin, address = start_twin("bench", "ball_beam", section, tmp_path / "twin.json", lambda: False)
        registered_processes.append(twin)
        draft = tmp_path / "draft"
        draft.symlink_to(address)
        draft.replace(name)
        return twin

    yield start
    for twin in registered_processes:
        twin.stop()


@pytest.mark.extended
def test_a_device_that_was_unplugged_is_found_again(
    hold: Callable[..., Held], link: Callable[[], Any], tmp_path: Path
) -> None:
    twin = link()
    run = hold(device("bench", str(tmp_path / "ttyBENCH"), "reconnect = true"), duration=4.0)
    run.wait_for(RunState.RUNNING, elapsed=1.0)
    os.kill(twin.pid, signal.SIGKILL)
    run.wait_for(RunState.PAUSED)
    assert "looking for it again" in run.control.reason or "no samples" in run.control.reason
    with pytest.raises(AssertionError):
        assert run.control.wait_for(RunState.RUNNING, timeout=0.5)
    link()
    run.wait_for(RunState.RUNNING)
    result, recording = run.finish()
    assert result.exit_status == 0, result.reason
    assert "reconnected" in kinds(recording, "bench")
    assert recording.stream_with("ball_position").lost > 50


# what is refused


def test_a_streamed_setpoint_that_is_no_number_or_from_the_future_is_refused(bench: Any) -> None:
    bench.take_lease()
    bench.put(float("nan"))
    assert "servo_angle: expected a finite number" in bench.wait_for_event("refused")["message"]
    with pytest.raises(CommandRefusedError, match="from the future"):
        bench.set(0.1, age=-2.0 * PATIENT_WATCHDOG)
    with pytest.raises(CommandRefusedError, match="a setpoint is"):
        bench.ask("set", token=bench.token, t_ns=time.time_ns(), values={"servo_angle": None})
    unknown = Setpoint(bench.token, time.time_ns(), {"servo": 0.1})
    publish_command(bench.bus, setpoint_key("bench"), unknown.to_bytes())
    wait_until(lambda: any("'servo'" in e["message"] for e in bench.events), "the name was not refused")
    status = bench.ask("status")
    assert (status["state"], status["applied"]) == ("idle", {"servo_angle": 0.0})
    assert 0.0 < status["lease_left"] <= 2.0
    assert status["age"] < 1.0


def test_a_sample_that_is_no_number_is_outside_its_limits() -> None:
    limits = SampleLimits(STREAM, (), {"ball_position": Limit(min=-0.2, max=0.2)})
    assert limits.violation(samples(0.1, 0.2)) is None
    assert "ball_position = 0.3 left its limits" in str(limits.violation(samples(0.1, 0.3)))
    assert "ball_position = nan" in str(limits.violation(samples(float("nan"))))
