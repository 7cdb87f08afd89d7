"""The evidence of structures, against brute force and against what a shipped recording is made of."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import integrate

from labhil.analysis.dataset import load_dataset
from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.structures.claims import Stage, refute
from labhil.diagnose.structures.disturbance import Disturbance
from labhil.diagnose.structures.enumerate import Prediction
from labhil.diagnose.structures.marginal import (
    KAPPA_GRID,
    Batch,
    GramMatrices,
    WeightedProducts,
    build_gram_matrices,
    extended_evidence,
    log_evidence,
    solve,
)  # fmt: skip
from labhil.diagnose.structures.stages import search_structures
from labhil.diagnose.structures.state import Exchange, RefittedStructure, SearchState, rivals_of

ROOT = Path(__file__).parents[2]


def one(columns: list[int], block: list[int], positive: list[bool]) -> Batch:
    return Batch(np.array([columns], int), np.array([block], int), np.array([positive], bool))


def undisturbed(matrix: np.ndarray) -> GramMatrices:
    return disturbed(matrix, np.zeros((len(matrix), 0)), ())


def disturbed(matrix: np.ndarray, modes: np.ndarray, sizes: tuple[float, ...]) -> GramMatrices:
    """Inner products of target and one response under a disturbance that is a sum of modes (n, K)."""
    n, grid = len(matrix), Disturbance.grid(1, sizes)
    views = []
    for tau in grid.size:
        covariance = np.eye(n) + tau**2 * modes @ modes.T
        log_det = float(np.linalg.slogdet(covariance)[1])
        views.append(WeightedProducts((matrix.T @ np.linalg.solve(covariance, matrix))[None], -0.5 * log_det))
    acts = np.ones((1, matrix.shape[1]), dtype=bool)
    return build_gram_matrices(views, 0, acts, n, n, n, np.log(grid.weight)).with_precisions(
        [(range(1, 2), None)]
    )


def test_the_evidence_of_one_size_is_its_integral() -> None:
    random = np.random.default_rng(4)
    n = 60
    response = random.standard_normal(n)
    target = random.standard_normal(n) - 0.7 * response
    matrix = np.column_stack([target, response])
    seen = undisturbed(matrix)
    with_it, _, size = log_evidence(seen, one([1], [0], [False]))
    without, *_ = log_evidence(seen, one([], [], []))
    kappa = KAPPA_GRID[
        np.argmin(np.abs(np.log(KAPPA_GRID / np.sqrt(size[0, 0] ** 2 * (response @ response) / n))))
    ]
    spread = kappa * np.sqrt(n / (response @ response))
    power = float(target @ target)

    # x given σ is normal with standard deviation σ·spread; σ integrates to a power of the penalised squares
    def weight(x: float) -> float:
        left = target + response * x
        squares = float(left @ left) + (x / spread) ** 2
        return float((squares / power) ** (-0.5 * (n + 1)))

    inside, _ = integrate.quad(weight, -5.0, 5.0, points=[size[0, 0]])
    normal, _ = integrate.quad(lambda u: (1.0 + u * u) ** (-0.5 * (n + 1)), -np.inf, np.inf)
    expected = np.log(inside / (normal * np.sqrt(power) * spread * len(KAPPA_GRID)))
    assert with_it[0] - without[0] == pytest.approx(expected, abs=0.05)
    assert size[0, 0] == pytest.approx(0.7, abs=0.3)


def test_a_size_that_cannot_be_negative_gains_where_it_is_positive_and_loses_where_it_would_be_negative() -> (
    None
):
    random = np.random.default_rng(5)
    response = random.standard_normal(200)
    for true, better in ((0.3, True), (-0.3, False)):
        matrix = np.column_stack([random.standard_normal(200) - true * response, response])
        seen = undisturbed(matrix)
        free, *_ = log_evidence(seen, one([1], [0], [False]))
        bound, *_ = log_evidence(seen, one([1], [0], [True]))
        assert (bound[0] > free[0]) == better


def test_a_smooth_disturbance_takes_the_evidence_from_a_term_that_imitates_it() -> None:
    random = np.random.default_rng(6)
    n = 400
    t = (np.arange(n) + 0.5) / n
    modes = np.sqrt(2.0 / n) * np.cos(np.pi * np.arange(1, 9) * t[:, None])
    shape = random.standard_normal(8)
    response = modes @ (shape + 0.5 * random.standard_normal(8))
    target = random.standard_normal(n) + 20.0 * modes @ shape
    matrix = np.column_stack([target, response])
    gains = []
    for sizes in ((), (1.0,)):
        seen = disturbed(matrix, np.sqrt(n) * modes, sizes)
        with_it, *_ = log_evidence(seen, one([1], [0], [False]))
        gains.append(with_it[0] - log_evidence(seen, one([], [], []))[0][0])
    assert gains[0] > 20.0
    assert gains[1] < 0.5 * gains[0]


def test_an_effect_of_thousands_of_noise_levels_is_seen_beside_a_disturbance_of_that_size() -> None:
    """The fine encoder of a rough machine: a disturbance takes weight from data, not from the effect."""
    random = np.random.default_rng(8)
    n, size = 600, 3000.0
    t = (np.arange(n) + 0.5) / n
    falls = 1.0 / (1.0 + (np.arange(n) / 4.0) ** 2)
    modes = np.sqrt(2.0) * np.cos(np.pi * np.arange(n) * t[:, None]) * falls
    force = np.sign(np.sin(23.0 * t))
    response = np.cumsum(np.cumsum(force - force.mean()))
    response /= np.std(response)
    target = random.standard_normal(n) + size * (0.1 * modes @ random.standard_normal(n) - 0.5 * response)
    seen = disturbed(np.column_stack([target, response]), modes, (1.0, 10.0, 100.0, 1000.0, 1e4))
    without, *_ = log_evidence(seen, one([], [], []))
    with_it, _, sizes = log_evidence(seen, one([1], [0], [False]))
    assert sizes[0, 0] == pytest.approx(0.5 * size, rel=0.3)
    assert with_it[0] - without[0] > 10.0


def test_what_one_more_block_promises_is_what_the_evidence_is_with_it() -> None:
    """By the Schur complement and from scratch, of one size that cannot be negative and of a block of two."""
    random = np.random.default_rng(7)
    n, count = 300, 5
    responses = random.standard_normal((n, count))
    target = responses @ np.array([0.5, -0.3, 0.2, 0.1, 0.0]) + random.standard_normal(n)
    matrix = np.column_stack([target, responses])
    modes = np.cos(np.pi * np.arange(1, 5) * (np.arange(n)[:, None] + 0.5) / n)
    blocks = [(range(1, 2), None), (range(2, 3), None), (range(3, 4), None), (range(4, 6), None)]
    seen = disturbed(matrix, modes, (1.0, 10.0)).with_precisions(blocks)
    start = Batch(np.array([[1], [2]]), np.array([[0], [0]]), np.array([[False], [False]]))
    for block, positive in (([3], [True]), ([4, 5], [False, False])):
        logs, calm = extended_evidence(
            seen, start, solve(seen, start), np.array([block]), np.array([positive])
        )
        for s, first in enumerate((1, 2)):
            longer = one([first, *block], [0, *[1] * len(block)], [False, *positive])
            expected, undisturbed_too, _ = log_evidence(seen, longer)
            assert logs[s, 0] == pytest.approx(expected[0], abs=1e-5)
            assert calm[s, 0] == pytest.approx(undisturbed_too[0], abs=1e-5)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_terms_of_a_shipped_recording_are_found() -> None:
    dataset = load_dataset(
        ROOT / "recordings" / "ball_beam_identify.mcap", test_path=ROOT / "recordings" / "ball_beam_test.mcap"
    )
    data = prepare_data(dataset.model, dataset.train, dataset.test)
    found = search_structures(data, fit_baseline(data, ["viscous_friction"]), lambda text: None)
    assert {step.terms[0] for step in found.missing} == {"coulomb_friction", "stribeck_friction", "dead_zone"}


def test_a_term_takes_the_place_of_another() -> None:
    exchange = Exchange.between(frozenset({"a", "b"}), frozenset({"a", "c"}))
    assert exchange == Exchange(added="c", removed="b")
    assert exchange.of(frozenset({"b", "d"})) == {"c", "d"}
    assert exchange.applies_to(frozenset({"b", "d"}))
    assert not exchange.applies_to(frozenset({"b", "c"}))
    assert not exchange.applies_to(frozenset({"d"}))
    assert Exchange.between(frozenset({"a"}), frozenset({"a", "b"})) is None
    assert Exchange.between(frozenset({"a", "b"}), frozenset({"c", "d"})) is None


def state_of(log_evidence: dict[str, float], relevance: dict[str, float]) -> SearchState:
    """A finished search; structures by the letters of their terms."""
    nothing = cast(Any, SimpleNamespace(responses=None))
    return SearchState(
        min_relevance=1.0,
        refitted={
            frozenset(terms): RefittedStructure(
                cast(Any, SimpleNamespace(mean_squares=np.array([9.0 if terms == "" else 1.5]), theta=terms)),
                value,
                value,
                (),
                nothing,
                {term: relevance[term] for term in terms},
            )
            for terms, value in log_evidence.items()
        },
    )


def test_terms_that_differ_only_beside_an_error_that_others_explain_are_rivals() -> None:
    relevance = {"a": 2.0, "b": 2.0, "c": 0.3, "d": 0.2, "e": 0.1}
    alone = {"a": -100.0, "b": -150.0}
    assert rivals_of(state_of(alone, relevance), frozenset("a")) == ()
    together = {**alone, "acd": -10.0, "bcd": -13.0}
    (rival,) = rivals_of(state_of(together, relevance), frozenset("a"))
    assert (rival.term, rival.instead_of, rival.delta_bic) == ("b", "a", 6.0)
    assert rival.probability == pytest.approx(np.exp(-3.0))
    # the likeliest structures with either count, not the likeliest pair of them
    apart = {**alone, "ace": -40.0, "bce": -41.0, "acd": -10.0, "bcd": -30.0}
    assert rivals_of(state_of(apart, relevance), frozenset("a")) == ()


def test_a_prediction_is_corrected_by_what_its_refitted_subset_is_mispredicted_by() -> None:
    state = state_of({"": -60.0, "a": 0.0}, {"a": 2.0})
    state.predicted = {
        frozenset(terms): Prediction(frozenset(terms), value, value, (), np.empty(0))
        for terms, value in {"": -1.0, "a": 0.0, "b": -2.0, "ab": -3.0}.items()
    }
    corrected = {"".join(sorted(s)): p.log_evidence for s, p in state.corrected_predictions().items()}
    # the linearisation at a does not show a: without it nothing seems lost
    assert corrected == {"": -60.0, "a": 0.0, "b": -61.0, "ab": -3.0}
    assert rivals_of(state, frozenset("a")) == ()


def test_what_predicts_held_out_data_far_worse_is_refuted_however_likely_it_is() -> None:
    state = state_of({"": -300.0, "a": 0.0, "b": -50.0, "c": -52.0}, dict.fromkeys("abc", 2.0))
    assert state.best == frozenset("a")
    errors = {"": 1.9, "a": 1.0, "b": 1.5, "c": 1.0}
    data = SimpleNamespace(score_on_metric=lambda theta: SimpleNamespace(excess=errors[theta]))
    refute(Stage(cast(Any, data), state))
    assert not state.refuted  # one leaves only noise
    errors |= {"": 18.0, "a": 9.0, "b": 5.0, "c": 6.0}
    refute(Stage(cast(Any, data), state))
    assert state.refuted == {frozenset("a")}  # not the baseline, and not what is hardly worse
    assert state.best == frozenset("b")
    assert [rival.term for rival in rivals_of(state, state.best)] == ["c"]
    assert frozenset("a") not in state.log_evidence()
