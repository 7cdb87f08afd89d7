"""A run under somebody's hand: paused, resumed, stopped, aborted, from a thread and over the bus."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labhil.errors import CommandRefusedError, UsageError
from labhil.experiment.control import TRANSITIONS, RunControl, RunState
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.run import Progress, RunResult, run_experiment
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from labhil.recording.writer import FLUSH_INTERVAL
from labhil.service.messages import WATCHDOG

ROOT = Path(__file__).parents[2]
DOCS = Path(__file__).parents[2] / "docs"
PATIENCE = 90.0

RIG = """
[rig]
kind = "ball_beam"
[limits]
servo_angle = { min = -1.2, max = 1.2, rate = 12.0 }
ball_position = { min = -0.3, max = 0.3 } # beyond the stops: a ball that a busy machine drops ends no run
"""

EXPERIMENT = """
[experiment]
name = "held"
[devices.bench]
plugin = "ball_beam"
address = "twin"
rig = "rig.toml"
twin = { speed = 5.0, seed = 3, terms = ["viscous_friction", "coulomb_friction"] }
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "chirp"
frequencies = [0.2, 0.4]
amplitude = 0.3
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
duration = DURATION
"""


class Held:
    """A run in a thread of its own, with its handle and what it told."""

    def __init__(self, directory: Path, duration: float) -> None:
        (directory / "rig.toml").write_text(RIG)
        text = EXPERIMENT.replace("DURATION", repr(duration))
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
        assert self.control.wait_for(state, timeout=PATIENCE), self.control.refusal
        done = threading.Event()
        for _ in range(int(PATIENCE / 0.05)):
            # the handle knows of a state a moment before the run tells how far it came
            if self.told and self.told[-1].state is state and self.told[-1].elapsed >= elapsed:
                return
            done.wait(0.05)
        raise AssertionError(f"not told of {state} at {elapsed} s: {self.told[-1:]}")

    def finish(self) -> tuple[RunResult, Recording]:
        self.thread.join(PATIENCE)
        assert self.result is not None and self.result.path is not None
        return self.result, read_recording(self.result.path)


def run_events(recording: Recording) -> list[tuple[str, str]]:
    return [(e.body["kind"], e.body["message"]) for e in recording.events if e.device == "run"]


@pytest.fixture
def held(tmp_path: Path) -> Any:
    runs: list[Held] = []

    def start(duration: float) -> Held:
        runs.append(Held(tmp_path, duration))
        return runs[-1]

    yield start
    for run in runs:
        if run.thread.is_alive():
            run.control.abort("the test is over")
            run.thread.join(PATIENCE)


@pytest.mark.extended
def test_a_marker_stands_in_the_recording_at_its_moment(held: Callable[[float], Held]) -> None:
    run = held(100.0)
    run.wait_for(RunState.RUNNING, elapsed=2.0)
    with pytest.raises(CommandRefusedError, match="needs a text"):
        run.control.mark(" \n ")
    run.control.mark("oil added\nby hand")
    command = [sys.executable, "-P", "-m", "labhil", "mark", "the lamp went out"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("marked at ")
    assert done.stdout.endswith(" s of held\n")
    run.control.stop()
    _, recording = run.finish()
    marks = [event for event in recording.events if event.body.get("kind") == "mark"]
    assert [event.body["message"] for event in marks] == ["oil added by hand", "the lamp went out"]
    assert 0.0 < marks[0].t < marks[1].t < recording.duration
    state = recording.streams[0]
    for mark in marks:  # among the samples that came in around it, at five times real time
        row = int(np.searchsorted(state.t_acq_ns, mark.t_ns, side="right"))
        assert state.t[row - 1] <= mark.t <= state.t[row]
    with pytest.raises(CommandRefusedError, match="a run that is finished takes no marker"):
        run.control.mark("too late")


@pytest.mark.extended
def test_a_pause_makes_safe_and_the_steps_go_on_where_they_were(held: Callable[[float], Held]) -> None:
    run = held(8.0)
    run.wait_for(RunState.RUNNING, elapsed=3.0)
    run.control.pause("to look at the ball")
    run.wait_for(RunState.PAUSED)
    at_pause = run.told[-1].elapsed
    threading.Event().wait(0.5)
    assert run.told[-1].elapsed - at_pause < 0.2
    run.control.resume()
    run.wait_for(RunState.RUNNING)
    result, recording = run.finish()
    assert (result.exit_status, result.reason) == (0, "all steps are done")
    assert [kind for kind, _ in run_events(recording)] == [
        "starting", "running", "paused", "running", "stopping", "finished",
    ]  # fmt: skip
    assert ("paused", "to look at the ball") in run_events(recording)
    state = recording.stream_with("ball_position", "servo_angle")
    paused_ns = next(e.t_ns for e in recording.events if e.device == "run" and e.body["kind"] == "paused")
    since = (state.t_acq_ns - paused_ns) * 1e-9
    resting = (since > 0.1) & (since < 0.4)
    assert resting.sum() > 50
    assert np.abs(state["servo_angle"][resting]).max() < 1e-3
    # the pause of half a second lasted 2.5 s of the twin's world, during which samples were recorded
    assert state.t[-1] - state.t[0] > 8.0 + 2.0


@pytest.mark.extended
def test_a_stop_is_no_failure_and_an_abort_is(held: Callable[[float], Held]) -> None:
    run = held(100.0)
    run.wait_for(RunState.RUNNING, elapsed=0.5)
    run.control.stop("enough seen")
    result, recording = run.finish()
    assert (result.exit_status, result.reason) == (0, "enough seen")
    assert recording.complete
    assert run_events(recording)[-2:] == [("stopping", "enough seen"), ("finished", "enough seen")]
    with pytest.raises(CommandRefusedError, match="a run that is finished cannot be paused"):
        run.control.pause()

    run = held(100.0)
    run.wait_for(RunState.RUNNING, elapsed=0.5)
    run.control.pause()
    run.wait_for(RunState.PAUSED)
    run.control.abort("smells of smoke")
    result, recording = run.finish()
    assert (result.exit_status, result.reason) == (1, "smells of smoke")
    assert recording.complete
    assert [kind for kind, _ in run_events(recording)][-3:] == ["paused", "aborting", "failed"]


def test_a_stop_before_the_devices_are_there_ends_the_run_at_once(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG)
    control = RunControl()
    control.stop("never mind")
    text = EXPERIMENT.replace("DURATION", "100.0")
    result = run_experiment(parse_experiment(text, tmp_path / "e.toml"), tmp_path, control=control)
    assert (result.exit_status, result.reason, result.path) == (0, "never mind", None)
    with pytest.raises(UsageError, match="serves one run"):
        run_experiment(parse_experiment(text, tmp_path / "e.toml"), tmp_path, control=control)


def test_every_request_is_refused_where_the_table_does_not_allow_it() -> None:
    for state in RunState:
        for request, goal in (
            ("pause", RunState.PAUSED),
            ("resume", RunState.RUNNING),
            ("stop", RunState.STOPPING),
            ("abort", RunState.ABORTING),
        ):
            control = RunControl()
            control._state = state
            allowed = goal in TRANSITIONS[state] and (request != "resume" or state is RunState.PAUSED)
            if allowed:
                getattr(control, request)()
                assert control.take_request()[0] is goal
                continue
            with pytest.raises(CommandRefusedError, match=state.value):
                getattr(control, request)()


def test_a_request_to_end_is_not_taken_back() -> None:
    control = RunControl()
    control.become(RunState.STARTING, "")
    control.become(RunState.RUNNING, "")
    control.stop("first")
    with pytest.raises(CommandRefusedError, match="about to end: first"):
        control.pause()
    with pytest.raises(ValueError, match="cannot become finished"):
        control.become(RunState.FINISHED, "")


@pytest.mark.parametrize(
    ("page", "stated"),
    [
        ("explanation/architecture.md", f"forced to the disk every {FLUSH_INTERVAL:g} s"),
        ("explanation/decisions/0010-*.md", f"forced to the disk every {FLUSH_INTERVAL:g} s"),
        ("explanation/decisions/0014-*.md", f"watches commands ({WATCHDOG:g} s)"),
        ("explanation/safety.md", f"setpoints stop for {WATCHDOG:g} s"),
        ("how-to/ur5.md", f"ends after {WATCHDOG:g} s with exit 1"),
    ],
)
def test_a_number_in_the_documentation_is_that_of_the_code(page: str, stated: str) -> None:
    (path,) = DOCS.glob(page)
    assert stated in path.read_text(encoding="utf-8")


def test_a_disk_that_is_nearly_full_at_the_start_is_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labhil.recording.writer.MIN_FREE_SPACE", 2**60)
    (tmp_path / "rig.toml").write_text(RIG)
    experiment = parse_experiment(EXPERIMENT.replace("DURATION", "3.0"), tmp_path / "e.toml")
    result = run_experiment(experiment, tmp_path)
    assert (result.exit_status, result.path) == (1, None)
    assert "MB are left on the disk" in result.reason
    assert not list(tmp_path.glob("*.mcap*"))
