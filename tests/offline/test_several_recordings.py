"""Several recordings in one command: which values belong to which, and what cannot be taken together."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labhil.analysis.saved_model import values_of
from labhil.analysis.schema import FitPart, validate
from labhil_benchmarks.statistics.cases import driven, levels

RIG = '[rig]\nkind = "axis"\n[metric]\nhorizon = 1.0\n'
TERMS = "viscous_friction,coulomb_friction,constant_force"
QUICKLY = ("--terms", TERMS, "--estimator", "nlse", "--window", "0.6", "--intervals", "wald")
WORLDS = {"a": (95.0, -3.2), "b": (120.0, 4.0)}


@pytest.fixture(scope="module")
def tables() -> dict[str, str]:
    """Tables of an axis in two states, five seconds each."""
    found = {}
    for seed, (name, (mass, force)) in enumerate(WORLDS.items()):
        random = np.random.default_rng(seed)
        values = {"moving_mass": mass, "constant_force.force": force}
        terms, channels = tuple(TERMS.split(",")), (("position", "m"),)
        record, _ = driven(
            "axis", levels(1000, 60, 80.0, random), 0.005, values, terms, 60.0, False, random, channels
        )
        rows = np.column_stack([record.t, record.inputs, record.outputs])
        found[name] = "t,drive_force,position\n" + "".join(f"{t:.9g},{u:.9g},{x:.9g}\n" for t, u, x in rows)
    return found


@pytest.fixture
def axis(labhil, tables, tmp_path):
    """Import one of the tables with a rig file of its own; return the recording's path."""

    def make(name: str, rig: str = RIG, called: str | None = None) -> Path:
        called = called or name
        (tmp_path / f"{called}.csv").write_text(tables[name])
        (tmp_path / f"{called}.toml").write_text(rig)
        path = tmp_path / f"{called}.mcap"
        done = labhil("import", f"{called}.csv", "--rig", f"{called}.toml", "-o", path)
        assert done.status == 0, done.err
        return path

    return make


def fitted(labhil, tmp_path: Path, *arguments: object) -> tuple[dict[str, Any], str]:
    done = labhil("fit", *arguments, "--json", "fit.json")
    assert done.status == 0, done.err
    return json.loads((tmp_path / "fit.json").read_text(encoding="utf-8")), done.out


@pytest.mark.extended
def test_values_are_told_with_the_recording_that_they_belong_to(labhil, axis, tmp_path):
    a, b = axis("a"), axis("b")
    named = ("--per-recording", "moving_mass,constant_force")
    found, said = fitted(labhil, tmp_path, a, b, *QUICKLY, *named, "--html", "fit.html")
    assert [(s["path"], s["recording"]) for s in found["recordings"]] == [(str(a), 1), (str(b), 2)]
    rows = {(row["name"], row["recording"]): row for row in found["parameters"]}
    assert rows.keys() == {
        ("moving_mass", 1), ("moving_mass", 2), ("constant_force.force", 1), ("constant_force.force", 2),
        ("viscous_friction.coefficient", None), ("coulomb_friction.level", None),
    }  # fmt: skip
    for number, (mass, force) in enumerate(WORLDS.values(), 1):
        assert rows["moving_mass", number]["value"] == pytest.approx(mass, rel=0.01)
        assert rows["constant_force.force", number]["value"] == pytest.approx(force, abs=0.1)
    for data in ("train", "test"):
        each = found[data]["per_recording"]
        assert [own["recording"] for own in each] == [1, 2]
        assert [own["per_channel"][0]["channel"] for own in each] == ["position", "position"]
        assert min(own["rmse"] for own in each) <= found[data]["rmse"] <= max(own["rmse"] for own in each)
    assert "moving_mass@2" in said and f"@2  {b}" in said.replace("\n", "") and "train @2" in said
    page = (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "moving_mass@2" in page and "test @1" in page and "train @2" in page
    assert validate(FitPart, found, "fit").parameters[1].key == "moving_mass@2"
    assert labhil("report", "fit.json", "-o", "again.html").status == 0


@pytest.mark.extended
def test_a_fit_of_one_begins_a_fit_of_several_and_the_other_way_round(labhil, axis, tmp_path):
    a, b = axis("a"), axis("b")
    one, _ = fitted(labhil, tmp_path, a, *QUICKLY)
    assert "recording" not in json.dumps(one["parameters"])
    assert "per_recording" not in one["train"]
    (tmp_path / "one.json").write_text(json.dumps(one))
    own = ("--per-recording", "moving_mass,spring_force")
    both, _ = fitted(labhil, tmp_path, a, b, "--model", "one.json", "--window", "0.6", *own)
    assert both["terms"] == [*one["terms"], "spring_force"]
    assert {"moving_mass@1", "moving_mass@2"} <= values_of(tmp_path / "fit.json").keys()
    (tmp_path / "both.json").write_text(json.dumps(both))
    back, _ = fitted(labhil, tmp_path, b, "--model", "both.json", *QUICKLY)
    mass = next(row for row in back["parameters"] if row["name"] == "moving_mass")
    assert mass["value"] == pytest.approx(120.0, rel=0.01)


@pytest.mark.extended
def test_every_recording_may_have_a_test_of_its_own(labhil, axis, tmp_path):
    a, b = axis("a"), axis("b")
    named = ("--per-recording", "moving_mass,constant_force")
    found, _ = fitted(labhil, tmp_path, a, b, *QUICKLY, *named, "--test", a, "--test", b)
    roles = [(s["role"], s["recording"]) for s in found["recordings"]]
    assert roles == [("train", 1), ("train", 2), ("test", 1), ("test", 2)]
    assert found["test"]["r2"] > 0.999
    refused = labhil("fit", a, b, *QUICKLY, *named, "--test", a).refused()
    assert "--test: expected one for each of the 2 recordings" in refused


@pytest.mark.extended
def test_faults_are_told_of_the_recording_that_has_them(labhil, axis, tables, tmp_path):
    lines = tables["b"].splitlines(keepends=True)
    for i in range(600, 760):
        t, u, _ = lines[i].split(",")
        lines[i] = f"{t},{u},{lines[599].split(',')[2]}"
    tables = {**tables, "b": "".join(lines)}
    (tmp_path / "stuck.csv").write_text(tables["b"])
    a = axis("a")
    assert labhil("import", "stuck.csv", "--rig", "a.toml", "-o", "stuck.mcap").status == 0
    done = labhil("diagnose", a, "stuck.mcap", "--json", "found.json", "--html", "found.html")
    assert done.status == 0, done.err
    found = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "data_fault"
    assert {(fault["kind"], fault["recording"]) for fault in found["faults"]} == {("stuck", 2)}
    assert "Recording 2: position is stuck" in done.out.replace("\n", " ")
    assert [own["recording"] for own in found["improvement"]["per_recording"]] == [1, 2]
    # nothing was searched, so nothing is called sufficient or significant either
    assert "it suffices" in done.out and "p = 1" not in done.out and "*" not in done.out
    assert "p that the baseline suffices" not in (tmp_path / "found.html").read_text(encoding="utf-8")


REFUSED = {
    "unknown name": (("--per-recording", "moving_mas"), "did you mean 'moving_mass'"),
    "not fitted": ((*QUICKLY, "--per-recording", "backlash"), "add it to --terms"),
    "no such channel": (("--per-recording", "temperature_dependent_friction"), "needs temperature"),
    "known": (("--rig", "known.toml", "--per-recording", "moving_mass"), "the rig file's [known] gives it"),
}


@pytest.mark.extended
@pytest.mark.parametrize("case", REFUSED)
def test_a_name_that_means_nothing_is_refused(labhil, axis, tmp_path, case):
    a, b = axis("a"), axis("b")
    (tmp_path / "known.toml").write_text(f"{RIG}[known]\nmoving_mass = 95.0\n")
    arguments, told = REFUSED[case]
    assert told in labhil("fit", a, b, *arguments).refused()


@pytest.mark.extended
@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_recordings_that_do_not_belong_together_are_refused(labhil, axis, shipped, tmp_path, command):
    a = axis("a")
    ball = shipped / "ball_beam_test.mcap"
    assert "expected a recording of axis" in labhil(command, a, ball).refused()
    assert "the same recording as" in labhil(command, a, a).refused()
    assert "expected two recordings or more" in labhil(command, a, "--per-recording", "moving_mass").refused()
    other = axis("b", f"{RIG}[known]\nmoving_mass = 120.0\n", "other")
    said = labhil(command, a, other).refused()
    assert "[known] moving_mass = 120.0" in said and "give one for all with --rig" in said


def test_a_recording_too_short_among_others_is_named(labhil, axis, tables, tmp_path):
    a = axis("a")
    (tmp_path / "short.csv").write_text("".join(tables["b"].splitlines(keepends=True)[:40]))
    assert labhil("import", "short.csv", "--rig", "a.toml", "-o", "short.mcap").status == 0
    assert "short.mcap: too short to hold data out" in labhil("fit", a, "short.mcap", *QUICKLY).refused()
