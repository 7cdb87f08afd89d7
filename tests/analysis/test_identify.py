"""Estimates, their errors, and the metric, on recordings of the plant."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from statsmodels.regression.linear_model import OLS
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.tsa.stattools import acf

from labhil.errors import RecordingError
from labhil.identify import statistics
from labhil.identify.fit import Options, fit
from labhil.identify.fitted import fit_terms, start_theta
from labhil.identify.identifiability import invariants
from labhil.identify.score import score
from labhil.identify.windows import fit_windows, noise_of, scored_windows
from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.record import Record
from labhil.rig import parse_rig
from labhil_benchmarks.statistics.cases import CASES
from labhil_benchmarks.statistics.trial import run_trial

TERMS = ("viscous_friction", "coulomb_friction", "stribeck_friction")
TRUTH = {
    "viscous_friction.coefficient": 0.26,
    "coulomb_friction.level": 0.09,
    "stribeck_friction.level": 0.06,
    "stribeck_friction.velocity": 0.02,
}


def blank(n: int, period: float = 0.01) -> Record:
    return Record(period * np.arange(n), np.zeros((n, 1)), np.zeros((n, 1)), ("u",), ("y",), ("m",))


@pytest.fixture(scope="module")
def fitted(model: BallBeamModel, acquire):
    record = acquire(TERMS, 11, duration=30.0)
    test = acquire(TERMS, 12, duration=24.0, frequencies=(0.28, 0.39))
    return fit(model, record, TERMS, test=test)


@pytest.mark.extended
def test_the_truth_is_recovered_within_its_errors(fitted):
    for row in fitted.estimates:
        assert abs(row.value - TRUTH[row.name]) < 5.0 * row.std_error, row
        assert row.significant and row.identifiable and not row.at_bound
        assert row.ci99[0] < row.value < row.ci99[1]
        assert row.std_error_reference < 0.1 * row.std_error


def test_the_fit_reaches_the_noise_on_data_it_never_saw(fitted):
    assert 0.85 < fitted.test.rmse / fitted.test.noise_floor < 1.2
    assert fitted.test.r2 > 0.999
    assert fitted.ljung_box_p > 1e-4
    assert fitted.input_crosscorrelation_p > 1e-4


@pytest.mark.extended
def test_bounds_hold_and_a_term_that_is_not_there_stays_insignificant(model, acquire):
    record = acquire(("viscous_friction",), 5, duration=30.0, amplitude=0.3)
    result = fit(
        model, record, ("viscous_friction", "coulomb_friction"), test=record, options=Options(window=3.0)
    )
    rows = {row.name: row for row in result.estimates}
    assert rows["coulomb_friction.level"].value >= 0.0
    assert not rows["coulomb_friction.level"].significant
    assert rows["viscous_friction.coefficient"].significant


def test_projection_leaves_what_the_windows_own_states_cannot_explain(model, acquire):
    record = acquire(TERMS, 2, duration=12.0)
    found = fit_terms(model, record, TERMS[:2], 3.0, noise_of(record), iterations=5)
    problem, point = found.problem, found.solution.point
    lin = problem.linearise(point, found.solution.residuals)
    mine = problem.project(lin, lin.by_parameters)
    blocks = np.zeros((len(problem.owner), 2 * len(problem.windows)))
    for w in range(len(problem.windows)):
        rows = problem.owner == w
        blocks[rows, 2 * w : 2 * w + 2] = lin.by_states[rows]
    brute = lin.by_parameters - blocks @ np.linalg.lstsq(blocks, lin.by_parameters, rcond=1e-12)[0]
    assert np.allclose(mine, brute, atol=1e-5 * np.abs(lin.by_parameters).max())


@pytest.mark.extended
def test_a_linkage_of_which_nothing_is_known_is_estimated_as_a_ratio(acquire):
    text = '[rig]\nkind = "ball_beam"\n[known]\nball_mass = 0.261\nball_radius = 0.02\n'
    model = BallBeamModel(parse_rig(text, Path("rig.toml")))
    record = acquire(("viscous_friction", "coulomb_friction"), 7, duration=20.0)
    result = fit(
        model, record, ("viscous_friction", "coulomb_friction"), test=record, options=Options(window=3.0)
    )
    assert result.identifiability.rank == result.identifiability.of
    values = {row.name: row.value for row in result.estimates}
    assert values["linkage_ratio"] == pytest.approx(0.2, rel=0.01)


def test_invariants_name_products_of_powers():
    assert invariants(["a", "b", "c"], np.array([[0.7, 0.7, 0.0]])) == ("a/b",)
    assert invariants(["a", "b"], np.array([[0.7, -0.7]])) == ("a·b",)


def test_robust_covariance_is_newey_and_wests():
    random = np.random.default_rng(1)
    x = np.column_stack([np.ones(800), np.sin(np.arange(800) / 25)])
    noise = np.empty(800)
    noise[0] = 0.0
    for i in range(1, 800):
        noise[i] = 0.8 * noise[i - 1] + random.standard_normal()
    model = OLS(x @ [1.0, 2.0] + noise, x).fit()
    reach = statistics.bandwidth(x * model.resid[:, None])
    theirs = model.get_robustcov_results("HAC", maxlags=reach, use_correction=False).cov_params() * 800 / 798
    inverse = statistics.inverse_information(x)
    ours = inverse @ statistics.long_run_variance(x * model.resid[:, None]) @ inverse * 800 / 798
    assert np.allclose(ours, theirs, rtol=1e-6)
    assert reach > 3
    assert np.all(np.diag(statistics.robust_covariance(x, model.resid, 798)) >= 0.999 * np.diag(theirs))


def test_variance_of_a_mean_is_that_of_an_autoregression():
    """Of a mean of n samples: σ²(1 + ρ)/(1 − ρ)/n, on average over many short records."""
    random = np.random.default_rng(2)
    noise = lfilter([1.0], [1.0, -0.7], random.standard_normal((200, 600)))[:, 100:]
    ones = np.ones((500, 1))
    found = [statistics.autoregressive_variance(ones, r - r.mean(), 1)[0, 0] / 500**2 for r in noise]
    assert np.mean(found) == pytest.approx(1.0 / 0.3**2 / 500, rel=0.06)


def test_channels_of_one_sample_are_one_moment():
    """Two channels that rise and fall slowly together: their errors add up."""
    random = np.random.default_rng(4)
    slow = lfilter([1.0], [1.0, -0.9], random.standard_normal(2000))
    both = np.repeat(slow, 2)
    jacobian = np.ones((4000, 1))
    alone = statistics.robust_covariance(np.ones((2000, 1)), slow, 1999)
    together = statistics.robust_covariance(jacobian, both, 3999, 2)
    assert 0.8 * alone[0, 0] < together[0, 0] < 1.1 * alone[0, 0]


def test_whiteness_and_crosscorrelation_tell_null_from_signal():
    random = np.random.default_rng(3)
    white = random.standard_normal((40, 600))
    inputs = np.sin(np.arange(600) / 9.0)
    assert 0 < sum(statistics.whiteness(r) < 0.1 for r in white) < 12
    assert sum(statistics.input_crosscorrelation(r, inputs) < 0.1 for r in white) < 12
    assert statistics.whiteness(np.cumsum(white[0])) < 1e-6
    assert statistics.input_crosscorrelation(white[0] + 0.5 * inputs, inputs) < 1e-6


@given(seed=st.integers(0, 10**6), n=st.integers(25, 400), lags=st.integers(1, 20), rho=st.floats(-0.9, 0.9))
@settings(max_examples=40, deadline=None)
def test_autocorrelation_and_ljung_box_are_those_of_statsmodels(seed, n, lags, rho):
    noise = np.random.default_rng(seed).standard_normal(n)
    values = lfilter([1.0], [1.0, -rho], noise) + 3.0
    np.testing.assert_allclose(statistics.autocorrelation(values, lags), acf(values, nlags=lags), atol=1e-12)
    theirs = acorr_ljungbox(values, lags=[lags], return_df=True)["lb_pvalue"].iloc[0]
    assert statistics.whiteness(values, lags) == pytest.approx(theirs, rel=1e-9, abs=1e-300)


def test_noise_is_measured_without_a_model(acquire):
    record = acquire(TERMS, 21, duration=20.0)
    rounded = 0.5 / 2**10 / np.sqrt(12.0)
    assert noise_of(record)[0] == pytest.approx(np.hypot(4e-4, rounded), rel=0.15)


@given(st.integers(120, 3000), st.floats(0.2, 8.0))
@settings(max_examples=60, deadline=None)
def test_scored_windows_tile_the_record_and_never_overlap(n, horizon):
    record = blank(n)
    try:
        windows = scored_windows(record, horizon)
    except RecordingError as error:
        assert "too short" in str(error)
        assert record.t[-1] < max(0.5 * horizon, 0.2) + 0.5 * horizon + 0.02
        return
    rows = windows.whole.rows[windows.scored]
    assert np.all(np.diff(rows) == 1)
    lead = np.diff(np.flatnonzero(np.r_[True, np.diff(windows.lead.owner) > 0, True]))
    assert np.all(lead >= 20) or windows.lead.first[0] == 0


def test_a_record_without_enough_samples_says_how_many_it_has():
    with pytest.raises(RecordingError, match="12 samples, at least 20"):
        fit_windows(blank(12), 1.0)


def _covered(model: BallBeamModel, acquire, seed: int) -> dict[str, bool]:
    rows = fit(model, acquire(TERMS, seed), TERMS).estimates
    return {row.name: row.ci99[0] <= TRUTH[row.name] <= row.ci99[1] for row in rows}


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_99_percent_intervals_cover_the_truth_in_50_seeds(model, acquire):
    with ProcessPoolExecutor(2) as pool:
        seeds = list(pool.map(partial(_covered, model, acquire), range(100, 150)))
    shares = {name: float(np.mean([seed[name] for seed in seeds])) for name in TRUTH}
    print(shares)
    # Nominal is 99 %, and this falls short of it: 84 to 94 % were measured. One fit in six ends a few
    # units of χ² above the global minimum, with one window's state beside its best (see
    # docs/explanation/start-values-and-minima.md).
    # The floor here only keeps it from getting worse.
    assert min(shares.values()) >= 0.8


def test_the_true_model_scores_at_its_noise_floor(model, acquire):
    record = acquire(TERMS, 31, duration=40.0)
    marks = score(model, start_theta(model, TRUTH), record, noise_of(record))
    assert 0.9 < marks.rmse / marks.noise_floor < 1.2
    assert marks.horizon == 4.0


@pytest.mark.extended
def test_a_search_that_ends_in_a_wrong_valley_is_made_again():
    # by the first seed alone: a mass of 0.5 g where there are 64, and residuals of 2.7 times the noise
    trial = run_trial(CASES["solenoid"], 7, coloured=False)
    assert trial.residual < 1.1
    assert trial.r2_truth - trial.r2 < 1e-3
