"""Chapter 5 of the reference text: its data, the way from its parameters to ours, the parts, the page."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from rich.console import Console

from labhil.analysis.results import finite
from labhil.errors import UnknownNameError, UsageError
from labhil.identify.problem import Point
from labhil_benchmarks.reference import findings, published, run_reference
from labhil_benchmarks.reference.command import reference_command
from labhil_benchmarks.reference.levels import Levels
from labhil_benchmarks.reference.page import page
from labhil_benchmarks.reference.parts import PARTS, QUICK, Effort
from labhil_benchmarks.reference.result import Belief, Way, estimated_from, limits_from, linear_from
from labhil_benchmarks.reference.run import Kept
from labhil_benchmarks.reference.studies import STUDIES, studies_of
from labhil_benchmarks.reference.study import Bench

pytestmark = pytest.mark.extended

TINY = Effort(0.002, 1)


def silent(text):
    return None


@pytest.fixture(scope="module")
def motor():
    return Bench.of(STUDIES["motor_two_speed"], 0)


@pytest.fixture(scope="module")
def parts(motor):
    """The short parts, computed; the default's stands for a fit that came out at the truth."""
    found = {name: PARTS[name](motor, 0, TINY, silent) for name in ("limits", "rough", "swarm", "linear")}
    study, limits = motor.study, found["limits"]
    truth, reach = np.array(study.truth), 0.2 * np.abs(study.typical)
    values, low, high, text = (
        tuple(x.tolist()) for x in (1.01 * truth, truth - reach, truth + reach, 0.01 * reach)
    )
    belief = Belief(tuple(reach.tolist()), low, high, text, limits.bounds, 29.99)
    found["default"] = replace(found["rough"], values=values, residual=1.0, starts=0, belief=belief)
    return found


@pytest.mark.parametrize("study", STUDIES.values(), ids=lambda study: study.name)
def test_levels_go_to_ours_and_back(study):
    ours = study.levels.to_ours(study.truth)
    np.testing.assert_allclose(study.levels.to_text(ours), study.truth, rtol=1e-12, atol=1e-15)
    joint = "[1]" if study.name == "arm" else ""
    static = ours[f"coulomb_friction.level{joint}"] + ours[f"stribeck_friction.level{joint}"]
    rows = enumerate(study.parameters.rows)
    row = next(i for i, row in rows if len(row.keys) == 2 and row.joint in (None, 1))
    assert static == pytest.approx(study.truth[row])


def test_the_error_of_a_sum_takes_the_covariance():
    levels = Levels(published.TABLE_5_8.rows)
    keys = list(levels.keys)
    covariance = np.diag(np.full(len(keys), 1.0))
    i, j = keys.index("coulomb_friction.level"), keys.index("stribeck_friction.level")
    covariance[i, j] = covariance[j, i] = -0.9
    static = [row.symbol for row in published.TABLE_5_8.rows].index("F_s")
    assert levels.covariance(covariance, keys)[static, static] == pytest.approx(0.2)
    # slopes by the text's parameters are those by ours through the chain rule
    slopes = np.random.default_rng(0).standard_normal((7, len(keys)))
    step = np.zeros(len(keys))
    step[static] = 1.0
    ours = levels.to_ours(step)
    by_chain = slopes @ [ours[key] for key in keys]
    np.testing.assert_allclose(levels.jacobian(slopes, keys)[:, static], by_chain, atol=1e-12)


def test_the_texts_numbers_stand_as_printed():
    by_symbol = {row.symbol: row for row in published.TABLE_5_8.rows}
    assert (by_symbol["m_s"].pso, by_symbol["m_s"].nlse, by_symbol["m_s"].real) == (0.05504, 0.022476, 0.064)
    assert len(published.TABLE_5_14.rows) == 36
    second = [row for row in published.TABLE_5_14.rows if row.joint == 1]
    assert [row.nlse for row in second] == [9.08, 1.6, -4.008, -6.42, -0.56, 48.9]
    assert sum(row.r2 for row in published.TABLE_5_15.rows[::2][:3]) / 3 == pytest.approx(97.27, abs=0.01)


def test_the_texts_arithmetic_is_checked_against_itself():
    wrong = findings.wrong_errors()
    assert any(text.startswith("5.3 T_v3 NLSE 41") for text in wrong)
    assert not any(text.startswith("5.3 J ") for text in wrong)
    outside = findings.outside_of_interval()
    assert [text.split()[:2] for text in outside] == [["5.10", "ẋ_s"], ["5.14", "τ_c[1]"], ["5.14", "τ_s[2]"]]
    upside_down = ["5.3", "5.5", "5.14 joint 0", "5.14 joint 1", "5.14 joint 2"]
    assert [text.split(" 0.")[0] for text in findings.upside_down()] == upside_down
    assert any(text.startswith("5.9") for text in findings.implied_variances())


@pytest.mark.parametrize("name", [name for name in STUDIES if name != "arm"])
def test_plant_and_model_agree_over_a_whole_run(name):
    bench = Bench.of(STUDIES[name], 0)
    problem = bench.whole_run(bench.record)
    residuals = problem.residuals(problem.start())
    assert np.sqrt(np.mean(residuals**2)) == pytest.approx(1.0, abs=0.04)
    if name in ("bare_beam", "paper_tape"):
        # never at a stop, which the model does not have
        assert np.abs(bench.record.outputs).max() < 0.245


def test_speed_alone_leaves_one_scale_open(motor, parts):
    bounds = dict(zip(motor.study.labels, parts["limits"].bounds, strict=True))
    assert {label for label, bound in bounds.items() if bound is not None} == {"K", "ω_s"}
    assert 0.2 < bounds["K"] / 0.2 < 0.5
    # and the model agrees: the same speed, to the digit, with another winding and another rotor
    problem = motor.whole_run(motor.record)
    z = problem.start().z
    moved = z.copy()
    for i, place in enumerate(problem.free):
        key = problem.model.parameters[place].key
        if key in ("resistance", "inductance"):
            moved[i] *= 2.0
        elif key not in ("torque_constant", "stribeck_friction.velocity"):
            moved[i] /= 2.0
    states = problem.start().states
    same = problem.residuals(Point(z, states))
    np.testing.assert_allclose(problem.residuals(Point(moved, states)), same, atol=1e-4)


def test_the_swarm_stays_in_its_box_and_has_the_texts_particles(motor, parts):
    swarm, box = parts["swarm"], motor.study.box()
    ours = motor.study.levels.to_ours(swarm.values)
    assert all(low - 1e-9 <= ours[key] <= high + 1e-9 for key, (low, high) in box.items())
    assert swarm.evaluations == motor.study.swarm.particles * (TINY.iterations(motor.study) + 1)


def test_parts_are_the_same_after_they_were_kept(parts):
    readers = {"limits": limits_from, "linear": linear_from}
    for name, part in parts.items():
        assert readers.get(name, estimated_from)(json.loads(json.dumps(finite(asdict(part))))) == part


def test_tables_page_and_json_of_parts_that_were_kept(parts, tmp_path):
    kept = Kept(tmp_path / "kept", 0, TINY)
    for name, part in parts.items():
        kept.write(("motor_two_speed", name), part)
        if name != "linear":
            kept.write(("motor_two_current", name), of_two_outputs(part))
    said: list[str] = []
    reference = run_reference(
        ["5.1", "5.3", "5.4"], effort=TINY, cache=tmp_path / "kept", workers=1, progress=said.append
    )
    assert said == ["9 of 9 parts were computed before"]
    assert [table.number for table in reference.tables] == ["5.1", "5.3", "5.3", "5.3", "5.4", "5.4"]
    rows = {row.symbol: row for row in reference.tables[1].rows}
    assert rows["J"].bound is None
    assert rows["J"].figures[Way.TEXT_NLSE].error == pytest.approx(12.0)
    assert any("cannot be known" in text for text in reference.findings)
    assert json.loads(json.dumps(reference.to_json(), allow_nan=False))["schema"] == "labhil.reference/1"
    text = page(reference)
    assert "nan" not in text
    assert {line.count("|") for line in text.splitlines() if line.startswith("| K, N·m/A")} == {9}


def of_two_outputs(part):
    """The same part as if there had been two outputs."""
    names = [name for name in ("scores", "text_pso", "text_nlse") if hasattr(part, name)]
    return replace(part, **{name: getattr(part, name) * 2 for name in names})


def test_wrong_use_is_told():
    with pytest.raises(UnknownNameError, match=r"5\.99"):
        run_reference(["5.99"])
    with pytest.raises(UsageError, match="seed"):
        run_reference(["5.1"], seed=-1)
    assert [study.name for study in studies_of(["5.9"])] == ["solenoid"]


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_table_by_the_command_in_two_processes(tmp_path):
    with (tmp_path / "out.txt").open("w") as file:
        reference = reference_command(
            ["5.5"],
            quick=True,
            cache=tmp_path / "kept",
            markdown=tmp_path / "page.md",
            json_path=tmp_path / "all.json",
            console=Console(file=file),
        )
    assert reference.quick
    for row in reference.tables[0].rows:
        if row.bound is not None and row.default_bound is not None:
            assert abs(row.figures[Way.DEFAULT].value - row.truth) < 5.0 * row.default_bound
    assert len(list((tmp_path / "kept").glob(f"*.{QUICK.starts}.json"))) == 8
    assert "Table 5.5" in (tmp_path / "page.md").read_text(encoding="utf-8")
