"""The demo on a busy machine: slower attempts, and what it says about them; the runs are scripted."""

from __future__ import annotations

from pathlib import Path

import pytest

import labhil
from labhil.campaign import demo
from labhil.errors import ConditionError, DeviceSilentError, LabhilError, RunError, WatchdogError
from labhil.experiment.control import RunState
from labhil.experiment.experiment import Experiment
from labhil.experiment.result import Progress, RunResult, answer_path
from labhil.recording.contents import recording_status
from labhil.recording.reader import read_recording

BUSY = WatchdogError("bench: watchdog: commands stopped for 0.22 s")


class Runs:
    """Stands for ``run_experiment``: each run ends with the next error, None for one that succeeds.

    Each leaves a recording and what its twin conceals, as a run does.
    """

    def __init__(self, *errors: LabhilError | None) -> None:
        self.errors = list(errors)
        self.speeds: list[float] = []

    def __call__(self, experiment: Experiment, out: Path, progress: object) -> RunResult:
        self.speeds.append(experiment.devices["bench"].twin.speed)
        error = self.errors.pop(0)
        status = 0 if error is None else error.exit_status
        path = out / f"run-{len(self.speeds)}.mcap"
        for left in (path, answer_path(path, "bench", are_several=False)):
            left.touch()
        return RunResult(path, status, 60.0, (), "the end", error)


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def recorder(runs: Runs, said: list[str], out: Path, monkeypatch: pytest.MonkeyPatch) -> demo.Recorder:
    monkeypatch.setattr(demo, "run_experiment", runs)
    return demo.Recorder(out, demo.draw_physics(7), said.append, lambda: said.append("waited"))


def test_each_attempt_on_a_busy_machine_takes_twice_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, said = Runs(BUSY, DeviceSilentError("bench: silent"), None, None), list[str]()
    recording = recorder(runs, said, tmp_path, monkeypatch)
    assert recording.record("identify", 1) == tmp_path / "run-3.mcap"
    assert names_in(tmp_path) == ["run-3.mcap", "run-3.twin.json"], "what failed leaves nothing"
    assert said.count("waited") == 2
    assert "once more, at 1.25 instead of 2.5 times real time" in said[-1]
    recording.record("test", 2)
    assert runs.speeds == [5.0, 2.5, 1.25, 1.25], "what failed once is not tried again"


def test_a_machine_that_is_too_busy_for_all_gets_a_bench_whose_clock_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, said = Runs(*[BUSY] * len(demo.SPEEDS)), list[str]()
    recording = recorder(runs, said, tmp_path, monkeypatch)
    paths = [recording.record(role, seed) for role, seed in (("identify", 1), ("test", 2))]
    assert runs.speeds == list(demo.SPEEDS)
    assert sum("once more" in line for line in said) == len(demo.SPEEDS) - 1
    assert any("tried at 5, 2.5, 1.25 times real time" in line and "uptime" in line for line in said)
    answers = [answer_path(path, "bench", are_several=False) for path in paths]
    assert names_in(tmp_path) == sorted(path.name for path in (*paths, *answers))
    for path in paths:
        recorded = read_recording(path)
        (stream,) = recorded.streams
        assert (len(stream), stream.lost, recording_status(recorded)) == (6000, 0, "done")
        assert recorded.rig is not None
        assert recorded.metadata["simulation"]["clock"] == "waits for the controller"
        assert b"spring_force" not in recorded.attachments["experiment.toml"]


def test_another_fault_is_not_blamed_on_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    recording = recorder(Runs(ConditionError("no")), said, tmp_path, monkeypatch)
    with pytest.raises(RunError, match="the identify recording failed: no"):
        recording.record("identify", 1)
    assert said == []
    assert names_in(tmp_path) == ["run-1.mcap", "run-1.twin.json"], "what went wrong can be looked at"


@pytest.mark.extended
def test_a_fit_of_a_stepped_run_finds_what_the_twin_is_made_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    physics = demo.draw_physics(7)
    recording = recorder(Runs(), [], tmp_path, monkeypatch)
    recording.speeds = ()
    paths = [recording.record(role, seed) for role, seed in (("identify", 1), ("test", 2))]
    fit = labhil.fit(paths[0], test=paths[1], terms=list(physics.terms))
    assert fit.verdict == "explained"
    for name, value in physics.parameters.items():
        low, high = fit.parameters[name].ci99
        assert low - 0.05 * value < value < high + 0.05 * value, name


def test_a_share_is_named_only_while_the_run_goes_on() -> None:
    said: list[str] = []
    report = demo._progress_printer("test", said.append)
    for state, elapsed in ((RunState.STARTING, 0.0), (RunState.RUNNING, 6.1), (RunState.FAILED, 6.2)):
        report(Progress(state, elapsed, 60.0, ""))
    assert said == [
        "recording to test: starting",
        "recording to test: running, 10 %",
        "recording to test: failed",
    ]
