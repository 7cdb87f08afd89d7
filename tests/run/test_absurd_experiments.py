"""Experiment files with values that no experiment has: refused by name, before anything is started."""

from __future__ import annotations

from pathlib import Path

import pytest

from labhil.errors import ExperimentFileError
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.plan import make_plan

TEXT = """
[experiment]
name = "a"
[devices.bench]
plugin = "ball_beam"
address = "twin"
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "multisine"
frequencies = [0.2, 0.3]
amplitude = 0.01
duration = 5.0
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"multisine"', "[]", r"steps\.0\.excitation: expected a text"),
        ('"multisine"', "{ a = 1 }", r"steps\.0\.excitation: expected a text"),
        ("0.2, 0.3", "0.2, 1e308", r"steps\.0: the excitation cannot be calculated"),
        ("5.0", "1e308", r"steps\.0: the excitation cannot be calculated: expected at most"),
        ("5.0", "1e12", r"steps\.0: the excitation cannot be calculated: expected at most"),
    ],
)
def test_a_value_that_no_experiment_has_is_refused_by_name(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in TEXT
    assert make_plan(parse_experiment(TEXT, tmp_path / "e.toml"))
    with pytest.raises(ExperimentFileError, match=rf"(?i)e\.toml: {message}"):
        make_plan(parse_experiment(TEXT.replace(old, new), tmp_path / "e.toml"))
