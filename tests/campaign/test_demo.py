"""The demo on a busy machine: slower attempts, and what it says about them; the runs are scripted."""

from __future__ import annotations

from pathlib import Path

import pytest

from labhil.campaign import demo
from labhil.errors import ConditionError, DeviceSilentError, LabhilError, RunError, WatchdogError
from labhil.experiment.control import RunState
from labhil.experiment.experiment import Experiment
from labhil.experiment.result import Progress, RunResult

BUSY = WatchdogError("bench: watchdog: commands stopped for 0.22 s")


class Runs:
    """Stands for ``run_experiment``: each run ends with the next error, None for one that succeeds."""

    def __init__(self, *errors: LabhilError | None) -> None:
        self.errors = list(errors)
        self.speeds: list[float] = []

    def __call__(self, experiment: Experiment, out: Path, progress: object) -> RunResult:
        self.speeds.append(experiment.devices["bench"].twin.speed)
        error = self.errors.pop(0)
        status = 0 if error is None else error.exit_status
        return RunResult(out / "run.mcap", status, 60.0, (), "the end", error)


def record(runs: Runs, monkeypatch: pytest.MonkeyPatch) -> tuple[list[str], Path | str]:
    """The lines that a recording says, and its path or the message of its error."""
    monkeypatch.setattr(demo, "run_experiment", runs)
    said: list[str] = []
    try:
        path = demo._record(
            "identify", Path("out"), demo.draw_physics(1), 1, said.append, lambda: said.append("waited")
        )
    except RunError as error:
        return said, str(error)
    return said, path


def test_each_attempt_on_a_busy_machine_takes_twice_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = Runs(BUSY, DeviceSilentError("bench: silent"), None)
    said, path = record(runs, monkeypatch)
    assert path == Path("out/run.mcap")
    assert runs.speeds == [5.0, 2.5, 1.25]
    assert [line for line in said if line == "waited"] == ["waited", "waited"]
    assert "once more, at 1.25 instead of 2.5 times real time" in said[-1]


def test_a_line_promises_another_attempt_only_where_one_follows(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = Runs(*[BUSY] * len(demo.SPEEDS))
    said, message = record(runs, monkeypatch)
    assert runs.speeds == list(demo.SPEEDS)
    assert sum("once more" in line for line in said) == len(demo.SPEEDS) - 1
    assert "failed at 5, 2.5, 1.25 and 0.625 times real time" in str(message)
    assert "uptime" in str(message)


def test_another_fault_is_not_blamed_on_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = Runs(ConditionError("no"))
    assert record(runs, monkeypatch) == ([], "the identify recording failed: no")


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
