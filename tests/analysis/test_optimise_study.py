"""Appendix A from the runs to the picture, small; the whole of it under ``extended``."""

from __future__ import annotations

import io
import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from labhil.optimise.circuit import force_curves, positions
from labhil.optimise.database import Database, select_distinct
from labhil.optimise.geometry import LEVELS, LOWER, ORIGINAL, UPPER
from labhil.optimise.objectives import Objectives, largest_force, mean_slope, pareto_front, rms_slope
from labhil.optimise.plot import plot
from labhil.optimise.runs import COUNT, design_runs
from labhil.optimise.sensitivity import global_sensitivity
from labhil.optimise.show import show
from labhil.optimise.study import REFINED_NAME, Optimisation, StudyOptions, run
from labhil.optimise.swarm import maximise

pytestmark = pytest.mark.extended

SMALL = StudyOptions(
    held_out=10, swarms=2, iterations=8, best_known=4, rounds=2, local_evaluations=12, n_directions=3, sobol=8
)


@pytest.fixture(scope="module")
def study() -> Optimisation:
    return run(4, options=SMALL)


@pytest.fixture(scope="module")
def database() -> Database:
    designs = design_runs().designs
    return Database(designs, force_curves(designs))


def test_the_runs_are_55_different_ones_at_the_levels_of_the_table() -> None:
    runs = design_runs(7)
    assert runs.designs.shape == (COUNT, 5)
    assert len(np.unique(runs.designs, axis=0)) == COUNT == len(runs.kinds)
    for j in range(5):
        assert set(runs.designs[:, j]) == set(LEVELS[j])
    assert runs.kinds.count("original") == 1
    assert runs.designs[runs.kinds.index("original")] == pytest.approx(ORIGINAL)


def test_every_pair_of_levels_occurs_once_among_the_pairs() -> None:
    runs = design_runs(1)
    rows = runs.designs[[kind == "pairs" for kind in runs.kinds]]
    for j, k in combinations(range(5), 2):
        assert len(np.unique(rows[:, [j, k]], axis=0)) == 25


def test_runs_follow_their_seed() -> None:
    assert np.array_equal(design_runs(2).designs, design_runs(2).designs)
    assert not np.array_equal(design_runs(2).designs, design_runs(3).designs)


def test_interpolation_goes_through_its_runs(database: Database) -> None:
    assert database.interpolate(database.designs) == pytest.approx(database.curves, abs=1e-6)
    assert database.leave_one_out().shape == database.curves.shape


def test_objectives_of_curves_that_are_known() -> None:
    x = positions()
    curves = np.vstack([50.0 + 2e3 * x, 80.0 - 8e3 * (x - 2.5e-3), 60.0 + 4e3 * x])
    assert largest_force(curves) == pytest.approx([60.0, 100.0, 80.0])
    assert rms_slope(curves) == pytest.approx([2e3, 8e3, 4e3])
    assert mean_slope(curves) == pytest.approx([2e3, -8e3, 4e3])
    expected = np.array([[0.0, 1.0], [1.0, 0.0], [0.5, (1 / 4 - 1 / 8) / (1 / 2 - 1 / 8)]])
    assert Objectives.of(curves)(curves) == pytest.approx(expected)


def test_an_arch_is_not_level() -> None:
    arch = 60.0 - 4e6 * (positions() - positions().mean())[None, :] ** 2
    assert mean_slope(arch) == pytest.approx([0.0], abs=1e-6)
    assert rms_slope(arch)[0] > 1e4


def test_the_front_is_what_comparing_all_with_all_finds() -> None:
    values = np.random.default_rng(0).random((200, 2))
    beaten = [np.any(np.all(values >= row, axis=1) & np.any(values > row, axis=1)) for row in values]
    assert set(pareto_front(values)) == set(np.flatnonzero(~np.array(beaten)))
    thinned = values[pareto_front(values, 0.2)]
    assert np.linalg.norm(np.diff(thinned, axis=0), axis=1).min() >= 0.2


def test_a_swarm_finds_a_hill_and_stays_in_its_box() -> None:
    seen = []

    def hill(X: np.ndarray) -> np.ndarray:
        seen.append(X)
        return np.asarray(-np.sum((X - np.array([0.3, 1.5])) ** 2, axis=1))

    flight = maximise(hill, np.zeros(2), np.ones(2), 0, 60)
    assert flight.best == pytest.approx([0.3, 1.0], abs=1e-2)
    assert flight.value == pytest.approx(-0.25, abs=1e-2)
    visited = np.concatenate(seen)
    assert visited.min() >= 0.0
    assert visited.max() <= 1.0


def test_designs_that_are_known_already_are_left_out() -> None:
    near = LOWER + 0.003 * (UPPER - LOWER)
    assert len(select_distinct(np.vstack([near, UPPER, UPPER]), LOWER[None, :])) == 1


def test_sobol_shares_of_a_sum_are_those_of_its_terms() -> None:
    shares = np.array([0.6, 0.3, 0.05, 0.03, 0.02])

    def curves_of(designs: np.ndarray) -> np.ndarray:
        level = 100.0 + 10.0 * ((designs - LOWER) / (UPPER - LOWER)) @ np.sqrt(shares)
        return np.stack([level, 0.5 * level], axis=1)

    found = global_sensitivity(curves_of, 512, np.random.default_rng(0))
    assert found.first_order[0] == pytest.approx(shares, abs=0.03)
    assert found.total == pytest.approx(np.vstack([shares, shares]), abs=0.03)
    assert np.all((found.total_low < found.total) & (found.total < found.total_high))


def test_the_study_is_never_worse_than_any_design_it_evaluated(study: Optimisation) -> None:
    best = (study.scores @ (1.0, 1.0)).max()
    assert study.candidate(REFINED_NAME).cost == pytest.approx(best, rel=1e-6)
    refined = study.candidate(REFINED_NAME).design
    assert np.all((refined >= LOWER - 1e-12) & (refined <= UPPER + 1e-12))
    assert set(study.front) <= set(range(len(study.evaluated)))
    better = study.flattest_with_force_of(study.candidates[0])
    assert study.scores[better, 0] >= study.candidates[0].scores[0] - 1e-9
    assert study.slope_of(better) <= study.candidates[0].rms_slope * (1 + 1e-9)


def test_the_same_seed_gives_the_same_study(study: Optimisation) -> None:
    again = run(4, options=SMALL)
    assert np.array_equal(again.evaluated, study.evaluated)
    assert {**again.to_json(), "seconds": 0} == {**study.to_json(), "seconds": 0}


def test_the_study_as_data_and_as_text(study: Optimisation) -> None:
    data = json.loads(json.dumps(study.to_json(), allow_nan=False))
    assert data["schema"] == "labhil.optimise/1"
    assert len(data["database"]) == COUNT
    assert data["candidates"][0]["design"] == pytest.approx(ORIGINAL)
    assert data["sensitivity"]["local"]["original"]["elasticity"][0][4] is None
    page = io.StringIO()
    show(study, Console(width=140, file=page))
    text = page.getvalue()
    assert "text's optimum  10.00" in text
    assert "Sobol, total" in text


def test_the_study_as_a_picture(study: Optimisation, tmp_path: Path) -> None:
    plot(study, tmp_path / "study.png")
    assert (tmp_path / "study.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_whole_study_ends_at_one_optimum_and_the_field_solver_agrees(tmp_path: Path) -> None:
    first, second = run(0, field=True), run(1)
    a, b = first.candidate(REFINED_NAME), second.candidate(REFINED_NAME)
    assert a.cost == pytest.approx(b.cost, rel=0.01)
    assert first.field is not None
    assert first.field.refined < 0.01
    assert np.median(first.field.ratios()) == pytest.approx(1.0, abs=0.05)
    assert np.all(np.abs(first.field.ratios() - 1.0) < 0.3)
    ours, original = (largest_force(first.field.curves[n][None])[0] for n in (REFINED_NAME, "original"))
    assert ours < original
    slopes = {name: rms_slope(curve[None])[0] for name, curve in first.field.curves.items()}
    assert slopes[REFINED_NAME] < 0.6 * slopes["original"]
    plot(first, tmp_path / "study.png")
    show(first, Console(quiet=True))
