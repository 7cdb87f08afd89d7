"""Plans in Python: what is yielded is run, what was recorded comes back, and a failure is theirs to take."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

import labhil as lh
from labhil.errors import ExperimentFileError, RunError
from labhil.recording.metadata import read_metadata

RIG = """[rig]
kind = "dc_motor"
[limits]
voltage = { min = -6.0, max = 6.0 }
speed = { min = -3.0, max = 3.0 }
"""

Plan = Generator[Any, Any, Any]

pytestmark = pytest.mark.timeout(600)


@pytest.fixture
def motor(tmp_path: Path) -> lh.Experiment:
    (tmp_path / "rig.toml").write_text(RIG)
    return lh.Experiment(
        "levels",
        devices={
            "bench": {
                "plugin": "dc_motor",
                "address": "twin",
                "rig": "rig.toml",
                "twin": {"speed": 5.0, "seed": 3},
            }
        },
        steps=[hold(0.0)],
        directory=tmp_path,
    )


def hold(level: float) -> dict[str, Any]:
    return {"device": "bench", "signal": "voltage", "excitation": "hold", "level": level, "duration": 1.0}


@pytest.mark.extended
def test_a_plan_decides_by_what_was_recorded(motor: lh.Experiment, tmp_path: Path) -> None:
    seen: list[float] = []

    def search() -> Plan:
        for level in (0.0, 2.0, 3.0):
            rec = yield {key: value for key, value in hold(level).items() if key != "device"}
            seen.append(float(rec["speed"].max()))
            if seen[-1] > 0.25:
                return level
        return None

    found = motor.run_plan(search, tmp_path / "out")
    assert found.value == 2.0
    assert len(found.recordings) == len(seen) == 2
    for number, path in enumerate(found.recordings, start=1):
        assert read_metadata(path)["plan"] == {"name": "search", "number": str(number)}
        assert read_metadata(path)["end"]["exit_status"] == "0"


@pytest.mark.extended
def test_a_run_that_fails_raises_in_the_plan_which_may_go_on(motor: lh.Experiment, tmp_path: Path) -> None:
    def careful() -> Plan:
        try:
            yield hold(6.0) | {"duration": 60.0}  # beyond the limit of the speed, before the time is over
        except RunError as error:
            told = str(error)
        yield [hold(1.0), hold(0.5)]
        return told

    found = motor.run_plan(careful, tmp_path / "out")
    assert "speed" in found.value
    assert len(found.recordings) == 1


def test_what_cannot_be_run_is_refused_before_anything_starts(motor: lh.Experiment, tmp_path: Path) -> None:
    closed: list[bool] = []

    def wrong(step: dict[str, Any]) -> Plan:
        try:
            yield step
        finally:
            closed.append(True)

    for step, told in (
        ({"signal": "voltage", "excitation": "hold", "levl": 1.0, "duration": 1.0}, "levl"),
        ({**hold(1.0), "signal": "volts"}, "volts"),
        ({**hold(1.0), "device": "other"}, "other"),
    ):
        with pytest.raises(ExperimentFileError, match=told):
            motor.run_plan(lambda step=step: wrong(step), tmp_path / "out")
    assert len(closed) == 3
    assert not list(tmp_path.glob("out/*.mcap"))


def test_a_plan_that_yields_nothing_records_nothing(motor: lh.Experiment, tmp_path: Path) -> None:
    def idle() -> Plan:
        return 7
        yield

    found = motor.run_plan(idle, tmp_path / "out")
    assert (found.recordings, found.value) == ((), 7)
