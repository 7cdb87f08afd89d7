"""A recording against an accepted model, as a gate: what passes, what does not, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labhil.physics.record import Record
from labhil.recording import import_table, write_import
from labhil.rig import parse_rig
from labhil_benchmarks.statistics.cases import driven, levels

TERMS = ("viscous_friction", "coulomb_friction", "constant_force")
VALUES = {
    "moving_mass": 95.0,
    "viscous_friction.coefficient": 204.0,
    "coulomb_friction.level": 20.4,
    "constant_force.force": -3.2,
}
ERRORS = (0.05, 0.3, 0.05, 0.03)
MODEL: Mapping[str, Any] = {
    "schema": "labhil.fit/1",
    "rig": "axis",
    "terms": list(TERMS),
    "parameters": [{"name": name, "joint": None, "value": value} for name, value in VALUES.items()],
    "covariance": np.diag(np.square(ERRORS)).tolist(),
}
RIG = '[rig]\nkind = "axis"\n'


def carriage(seed: int, values: Mapping[str, float] | None = None, terms: tuple[str, ...] = TERMS) -> Record:
    """Five seconds of force levels on the plant, with an encoder's noise."""
    random = np.random.default_rng(seed)
    inputs = levels(1000, 60, 80.0, random)
    own = {"constant_force.force": -3.2, **(values or {})}
    return driven("axis", inputs, 0.005, own, terms, 60.0, False, random, (("position", "m"),))[0]


@pytest.fixture
def record(labhil, tmp_path) -> Callable[..., str]:
    """Bring a record into a recording; return its name."""

    def made(name: str, found: Record) -> str:
        rows = np.column_stack([found.t, found.inputs, found.outputs])
        np.savetxt(tmp_path / "bench.csv", rows, "%.12g", ",", header="t,drive_force,position", comments="")
        (tmp_path / "rig.toml").write_text(RIG)
        done = labhil("import", "bench.csv", "--rig", "rig.toml", "-o", name)
        assert done.status == 0, done.err
        return name

    return made


@pytest.fixture
def accepted(tmp_path) -> Callable[..., str]:
    """Write a model file, with other fields than usual where they are given; return its name."""

    def made(**other: Any) -> str:
        (tmp_path / "model.json").write_text(json.dumps({**MODEL, **other}), encoding="utf-8")
        return "model.json"

    return made


@pytest.fixture(scope="module")
def of_the_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that any model of an axis may be held against; nobody changes it."""
    folder = tmp_path_factory.mktemp("recorded")
    found = carriage(7)
    rows = np.column_stack([found.t, found.inputs, found.outputs])
    np.savetxt(folder / "bench.csv", rows, "%.12g", ",", header="t,drive_force,position", comments="")
    rig = parse_rig(RIG, folder / "rig.toml")
    return write_import(import_table(folder / "bench.csv", rig), folder / "g.mcap")


def answer(tmp_path: Path) -> dict[str, Any]:
    text = (tmp_path / "out.json").read_text(encoding="utf-8")
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in a JSON file"))


@pytest.mark.extended
def test_a_recording_of_the_model_itself_passes(labhil, record, accepted, tmp_path):
    done = labhil("verify", record("a.mcap", carriage(1)), "--model", accepted(), "--json", "out.json")
    assert done.status == 0, done.out + done.err
    assert "consistent" in done.out
    found = answer(tmp_path)
    assert (found["schema"], found["verdict"], found["reasons"]) == (
        "labhil.verification/1", "consistent", [],
    )  # fmt: skip
    assert found["p_value"] >= found["alpha"] == 1e-3
    (channel,) = found["channels"]
    assert 0.8 < channel["ratio"] < 1.15 < channel["limit"]
    assert [row["name"] for row in found["parameters"]] == list(VALUES)
    assert not any(row["changed"] for row in found["parameters"])


@pytest.mark.extended
def test_more_friction_is_a_contradiction_that_is_named(labhil, record, accepted, tmp_path):
    stiff = carriage(2, {"viscous_friction.coefficient": 1.2 * 204.0})
    done = labhil("verify", record("b.mcap", stiff), "--model", accepted(), "--json", "out.json")
    assert done.status == 1, done.err
    assert "contradicts" in done.out
    found = answer(tmp_path)
    assert found["verdict"] == "contradicted"
    rows = {row["name"]: row for row in found["parameters"]}
    friction = rows["viscous_friction.coefficient"]
    assert friction["changed"]
    assert friction["before"] == 204.0
    assert friction["after"] == pytest.approx(1.2 * 204.0, rel=0.02)
    ratios = [window["ratio"] for window in found["worst_windows"]]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[0] > 5.0
    assert all(0.0 <= w["begin"] < w["end"] <= 5.0 for w in found["worst_windows"])


def test_a_delay_leaves_residuals_that_no_values_explain(labhil, record, accepted, tmp_path):
    late = carriage(3, {"time_delay.delay": 0.01}, (*TERMS, "time_delay"))
    done = labhil("verify", record("c.mcap", late), "--model", accepted(), "--json", "out.json")
    assert done.status == 1, done.err
    assert "physics is missing" in done.out
    (channel,) = answer(tmp_path)["channels"]
    assert channel["structure_p"] < 1e-6


@pytest.mark.extended
def test_without_a_covariance_values_count_as_exact(labhil, record, accepted):
    name = record("d.mcap", carriage(4))
    done = labhil("verify", name, "--model", accepted(covariance=None))
    assert done.status == 0, done.out
    assert "taken as exact" in done.out
    wrong = [{**row, "value": 1.01 * row["value"]} for row in MODEL["parameters"]]
    assert labhil("verify", name, "--model", accepted(covariance=None, parameters=wrong)).status == 1
    # a model that knows its values badly is not contradicted by what lies within its errors
    badly = np.diag([4.0, 16.0, 1.0, 1.0]).tolist()
    assert labhil("verify", name, "--model", accepted(covariance=badly, parameters=wrong)).status == 0


@pytest.mark.extended
def test_a_fit_passes_on_another_recording_of_the_same_plant(labhil, record):
    first, second = record("e.mcap", carriage(5)), record("f.mcap", carriage(6))
    how = ("--terms", ",".join(TERMS), "--window", "2", "--estimator", "nlse", "--json", "fit.json")
    assert labhil("fit", first, *how).status == 0
    done = labhil("verify", second, "--model", "fit.json", "--alpha", "1e-4")
    assert done.status == 0, done.out


BAD = {
    "covariance": ({"covariance": [[1.0]]}, "covariance: expected 4 rows of 4 numbers"),
    "variance": ({"covariance": np.diag([-1.0, 1, 1, 1]).tolist()}, "no negative variance"),
    "schema": ({"schema": "something/1"}, "expected schema labhil.fit/1"),
    "rig": ({"rig": "dc_motor"}, "rig: expected a model of axis"),
    "term": ({"terms": ["viscous_frictoin"]}, "viscous_friction"),
    "lacking": (
        {"parameters": MODEL["parameters"][1:], "covariance": None},
        "expected a value of 'moving_mass'",
    ),
    "foreign": (
        {"parameters": [*MODEL["parameters"], {"name": "resistance", "value": 1.0}], "covariance": None},
        "found 'resistance'",
    ),
    "window": ({"window": "long"}, "window: expected a finite number"),
    "train": ({"train": [1]}, "train: expected an object"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_file_that_is_no_model_of_this_rig_is_refused(labhil, of_the_model, accepted, what):
    other, expected = BAD[what]
    said = labhil("verify", of_the_model, "--model", accepted(**other)).refused()
    assert expected in said
    assert what == "term" or "model.json" in said


def test_what_is_not_there_is_refused(labhil, of_the_model, accepted):
    name = of_the_model
    assert "none.json" in labhil("verify", name, "--model", "none.json").refused()
    assert "none.mcap" in labhil("verify", "none.mcap", "--model", accepted()).refused()
    assert "--alpha" in labhil("verify", name, "--model", accepted(), "--alpha", "2").refused()
    said = labhil("verify", name, "--model", accepted(), "--json", "nowhere/out.json").refused()
    assert "nowhere" in said


def test_too_short_a_recording_is_refused(labhil, record, accepted):
    said = labhil("verify", record("i.mcap", carriage(9).part(0, 30)), "--model", accepted()).refused()
    assert "too short" in said


@pytest.mark.extended
def test_what_is_wrong_with_the_recording_is_named_before_the_model_is_blamed(
    labhil, record, accepted, tmp_path
):
    """An input whose stamps are late contradicts any model; a few spikes contradict none."""
    found, even = carriage(3), carriage(3, {"constant_force.force": 0.0})
    late = replace(even, inputs=np.concatenate([even.inputs[:1].repeat(2, axis=0), even.inputs[:-2]]))
    done = labhil("verify", record("late.mcap", late), "--model", accepted(), "--json", "out.json")
    assert done.status == 1
    assert [fault["kind"] for fault in answer(tmp_path)["faults"]] == ["lead"]
    assert "respond to drive_force 0.01 s (2 samples) before it changes" in done.out.replace("\n", " ")
    outputs = found.outputs.copy()
    outputs[[145, 400, 777], 0] += 0.5
    spiked = record("spiked.mcap", replace(found, outputs=outputs))
    done = labhil("verify", spiked, "--model", accepted(), "--json", "out.json")
    assert done.status == 0, done.out
    assert [fault["mended"] for fault in answer(tmp_path)["faults"]] == [True]
