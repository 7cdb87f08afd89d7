"""Steps that end early: the grammar of conditions, and what a run makes of one."""

from __future__ import annotations

from pathlib import Path

import pytest

from labhil.errors import ExperimentFileError, UnknownNameError
from labhil.experiment.condition import parse_condition
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.plan import make_plan
from labhil.experiment.run import run_experiment
from labhil.recording.reader import read_recording

TEXT = """
[experiment]
name = "cool"
[devices.bench]
plugin = "dc_motor"
address = "twin"
twin = { speed = 5.0, seed = 3 }
[[steps]]
device = "bench"
signal = "voltage"
excitation = "hold"
level = 5.0
duration = 50.0
until = "speed > 2"
[[steps]]
device = "bench"
signal = "voltage"
excitation = "hold"
level = -1.0
duration = 1.0
"""
COLUMNS = ("speed", "winding_temperature")


@pytest.mark.parametrize(
    ("text", "values", "expected"),
    [
        ("winding_temperature < 30", (0.0, 29.0), True),
        ("winding_temperature < 30", (0.0, 31.0), False),
        ("0 < speed <= 1", (1.0, 0.0), True),
        ("0 < speed <= 1", (0.0, 0.0), False),
        ("abs(speed) >= 2 or winding_temperature - 2*speed > 10", (-2.0, 0.0), True),
        ("not (speed / 2 > 1) and winding_temperature > -5", (1.0, 0.0), True),
        ("not (speed / 2 > 1) and winding_temperature > -5", (2.1, 0.0), False),
        ("speed < 1", (float("nan"), 0.0), False),
    ],
)
def test_a_condition_is_what_it_says(text: str, values: tuple[float, ...], expected: bool) -> None:
    assert parse_condition(text).bind(COLUMNS)(values) is expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "speed",
        "speed < ",
        "1 < 2",
        "speed == 1",
        "speed < 'a'",
        "speed < True",
        "speed / 0 < 1",
        "speed ** 9 < 1",
        "__import__('os').system('true') < 1",
        "speed.__class__ < 1",
        "[speed for speed in (1,)] < 1",
        "(lambda: speed)() < 1",
        "max(speed, 1) < 1",
        "abs(speed, key=1) < 1",
        "speed < 1e999",
        "(" * 240 + "speed" + ")" * 240 + " < 1",
        "-" * 600 + "speed < 1",
    ],
)
def test_what_is_no_condition_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        parse_condition(text)


def test_a_signal_that_is_not_there_is_named() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'speed'"):
        parse_condition("sped < 1").bind(COLUMNS)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("speed > 2", "sped > 2", r"steps.0.until: signal 'sped' does not exist \(did you mean 'speed'"),
        ("speed > 2", "speed = 2", r"steps.0.until: expected a condition like `speed < 0.1`"),
        ("duration = 1.0", "duration = 1.0\nat = 60.0", ""),
        (
            '[[steps]]\ndevice = "bench"\nsignal = "voltage"\nexcitation = "hold"\nlevel = -1',
            '[devices.other]\nplugin = "solenoid"\naddress = "twin"\n'
            '[[steps]]\ndevice = "bench"\nsignal = "voltage"\nexcitation = "hold"\nlevel = -1',
            "steps.0.until: expected an experiment with one device, found 2",
        ),
    ],
)
def test_a_condition_that_cannot_be_kept_is_refused(old: str, new: str, message: str) -> None:
    text, path = TEXT.replace(old, new), Path("cool.toml")
    if not message:
        make_plan(parse_experiment(text, path))
        return
    with pytest.raises(ExperimentFileError, match=message):
        make_plan(parse_experiment(text, path))


@pytest.mark.extended
def test_a_step_ends_when_its_condition_holds_and_the_next_one_follows(tmp_path: Path) -> None:
    experiment = parse_experiment(TEXT, tmp_path / "cool.toml")
    assert "ends early once speed > 2" in make_plan(experiment).describe()
    result = run_experiment(experiment, tmp_path)
    assert result.error is None
    assert result.path is not None
    recording = read_recording(result.path)
    assert recording.duration < 40.0
    asked = recording.stream_with("voltage_requested")["voltage_requested"]
    assert sorted(set(asked.tolist())) == [-1.0, 5.0]
    data = recording.stream_with("speed", "voltage")
    first = data.t[(data["speed"] > 2.0).argmax()]
    turned = data.t[(data["voltage"] < 0.0).argmax()]
    assert first < turned
    (event,) = [event for event in recording.events if event.body.get("kind") == "step"]
    assert event.body["message"].startswith("bench: steps.0 ended at ")
    assert event.body["message"].endswith(" s: speed > 2")
