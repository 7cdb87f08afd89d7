"""Diagnoses of plant recordings: named terms, their location, statements and plots."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labhil.analysis.results import Source, diagnosis_json
from labhil.diagnose import locate
from labhil.diagnose.answer import Diagnosis
from labhil.diagnose.diagnosis import diagnose
from labhil.diagnose.evidence import independent_samples
from labhil.identify.least_squares import least_squares
from labhil.identify.statistics import Estimate
from labhil.report.plots import diagnosis_figure

BASELINE = ("viscous_friction",)
DRY = ("viscous_friction", "coulomb_friction", "stribeck_friction")
TEST_TONES = (0.28, 0.39)
SOURCES = [Source("a.mcap", "0" * 64, "ball_beam", 6000, 59.99, "search")]


def diagnosed(
    model, acquire, terms, *, seed: int = 1, seconds: float = 60.0, baseline=BASELINE, **how: Any
) -> Diagnosis:
    searched = acquire(terms, seed, duration=seconds)
    judged = acquire(terms, seed + 1000, frequencies=TEST_TONES, duration=min(seconds, 40.0))
    return diagnose(model, searched, judged, heldout_is_test=True, baseline=baseline, **how)


@pytest.fixture(scope="module")
def null(model, acquire) -> Diagnosis:
    """Nothing is missing, but the value that the user believes in is wrong by far."""
    return diagnosed(model, acquire, BASELINE, reference={"viscous_friction.coefficient": 0.1})


@pytest.fixture(scope="module")
def dry(model, acquire) -> Diagnosis:
    """Dry friction with a Stribeck peak is missing."""
    return diagnosed(model, acquire, DRY, seconds=20.0)


def modelled(diagnosis: Diagnosis) -> float:
    """The contract's share of the removable squared error that was removed."""
    before, after, floor = diagnosis.before.mse, diagnosis.after.mse, diagnosis.after.noise_floor**2
    return (before - after) / (before - floor)


def test_a_changed_value_is_a_change_and_no_missing_physics(null):
    assert null.verdict == "parameter_change"
    assert (null.missing, null.location) == ((), None)
    (change,) = null.changed
    assert (change.name, change.before) == ("viscous_friction.coefficient", 0.1)
    assert change.after == pytest.approx(0.26, abs=0.01)
    assert change.ci99[0] < 0.26 < change.ci99[1]
    assert change.p_value < 1e-6


def test_a_complete_baseline_gives_an_empty_answer(null):
    assert null.p_value > 5e-4
    assert null.final_terms == null.baseline_terms == BASELINE
    assert null.after is null.before
    assert 0.85 < null.after.rmse / null.after.noise_floor < 1.15


def test_absent_effects_are_excluded_down_to_small_sizes(null):
    hidden = {item.term: item for item in null.excluded}
    assert "viscous_friction" not in hidden
    assert 0.0 < hidden["coulomb_friction"].largest_hidden < 0.005
    assert 0.0 < hidden["time_delay"].largest_hidden < 0.02
    assert all(item.confidence == 0.99 and math.isfinite(item.largest_hidden) for item in null.excluded)
    assert null.undecided == ()


@pytest.mark.extended
def test_dry_friction_is_found_and_nothing_else(dry):
    assert dry.verdict == "missing_physics"
    assert {item.term for item in dry.missing} == {"coulomb_friction", "stribeck_friction"}
    assert set(dry.final_terms) == set(DRY)
    truth = {
        "coulomb_friction.level": 0.09,
        "stribeck_friction.level": 0.06,
        "stribeck_friction.velocity": 0.02,
    }
    found = {row.name: row for item in dry.missing for row in item.parameters}
    assert set(found) == set(truth)
    for name, row in found.items():
        assert abs(row.value - truth[name]) < 5.0 * row.std_error, row


@pytest.mark.extended
def test_the_final_model_reaches_the_noise_floor_on_held_out_data(dry):
    assert dry.data == "test"
    assert dry.before.rmse > 10.0 * dry.before.noise_floor
    assert dry.after.rmse < 1.15 * dry.after.noise_floor
    assert modelled(dry) > 0.99


@pytest.mark.extended
def test_the_final_fit_stands_at_the_bottom_of_its_valley(dry):
    fitted = dry.final_fit
    further = least_squares(fitted.problem, fitted.solution.point, settled=True)
    assert fitted.solution.cost - further.cost < 1.0  # χ²: less than one standard error


def test_every_effect_that_is_named_is_supported_by_both_recordings(dry):
    for item in dry.missing:
        assert item.evidence.delta_bic < -10.0
        assert item.evidence.heldout_loglik_gain > 0.0
        assert item.evidence.p_value < 0.01
        assert 0.5 < item.probability <= 1.0
    order = [item.evidence.delta_bic for item in dry.missing]
    assert order == sorted(order), "ordered by evidence"


@pytest.mark.extended
def test_the_stribeck_peak_is_located_at_low_speed(dry):
    location = dry.location
    assert (location.channel, location.enters) == ("ball_position", "force")
    (regime,) = [r for r in location.regimes if r.coordinate == "ball_velocity"]
    assert -0.1 < regime.low < 0.0 < regime.high < 0.1
    # of the excess in data that the search never saw; the rest is where windows carry the peak's trace on
    assert 0.6 < regime.share_of_excess <= 1.0
    assert "ball_velocity" in location.statement
    assert location.times
    assert all(0.0 <= begin < end <= 20.0 for begin, end in location.times)


@pytest.mark.extended
def test_regimes_name_their_effect_and_effects_are_drawn_over_their_coordinate(dry):
    terms = {item.term for item in dry.missing}
    assert {regime.term for regime in dry.location.regimes} <= terms
    assert all(regime.joint is None for regime in dry.location.regimes)
    titles = {axes.get_title(loc="left"): axes.get_xlabel() for axes in diagnosis_figure(dry).axes}
    assert titles["Left out: stribeck_friction"] == "ball_velocity, m/s"
    assert {f"Left out: {term}" for term in terms} < set(titles)


def test_no_effect_is_drawn_where_none_is_missing(null):
    titles = [axes.get_title(loc="left") for axes in diagnosis_figure(null).axes]
    assert len(titles) == 4
    assert not any(title.startswith("Left out") for title in titles)


@pytest.mark.extended
def test_the_contribution_of_a_term_is_its_law(dry):
    found = locate.contribution(dry.final_fit, "stribeck_friction")
    values = {row.name: row.value for row in dry.final}
    v = found.coordinates["ball_velocity"]
    width = values["stribeck_friction.velocity"]
    expected = -values["stribeck_friction.level"] * np.exp(-np.abs(v) / width) * np.sign(v)
    assert np.allclose(found.values, expected, atol=1e-9)
    assert found.units["ball_velocity"] == "m/s"


def test_regimes_hold_four_fifths_of_the_excess_in_few_samples():
    x = np.linspace(-1.0, 1.0, 4001)
    excess = np.where(np.abs(x - 0.3) < 0.1, 1.0, 0.0)
    (regime,) = locate.regimes({"ball_position": x, "beside": x}, excess)
    assert regime.coordinate == "ball_position"
    assert (regime.low, regime.high) == pytest.approx((0.2, 0.4), abs=0.06)
    assert 0.8 <= regime.share_of_excess <= 1.0
    assert locate.regimes({"ball_position": x}, np.ones_like(x)) == ()


def test_a_regime_may_have_two_ranges():
    """An effect beyond a limit on both sides is located at both ends."""
    x = np.linspace(-1.0, 1.0, 4001)
    low, high = locate.regimes({"x": x}, np.maximum(np.abs(x) - 0.8, 0.0) ** 2)
    assert (low.low, high.high) == pytest.approx((-1.0, 1.0), abs=0.01)
    assert low.high < -0.75
    assert high.low > 0.75
    assert low.share_of_excess + high.share_of_excess >= 0.8


def test_an_effect_that_no_coordinate_locates_is_located_by_its_force():
    """A ripple of many waves: near its crests, where four fifths of the squares of a sine are."""
    x = np.linspace(-1.0, 1.0, 4001)
    wave = 3.0 * np.sin(200.0 * x)
    share = locate.Contribution("torque_ripple[1]", wave, "N·m", {"q_1": x}, {"q_1": "rad"}, 1)
    low, high = share.regimes()
    assert {low.coordinate, high.coordinate} == {"torque_ripple[1]"}
    assert {low.unit, high.unit} == {"N·m"}
    assert (low.low, high.high) == pytest.approx((-3.0, 3.0), abs=1e-3)
    # of sin², the share above |sin| = c is 2·(a + sin(2a)/2)/π with a = arccos c
    half = math.acos(high.low / 3.0)
    assert 2.0 * (half + math.sin(2.0 * half) / 2.0) / math.pi == pytest.approx(0.8, abs=0.01)
    assert low.share_of_excess + high.share_of_excess == pytest.approx(0.8, abs=0.01)
    assert replace(share, unit="").regimes() == ()
    assert replace(share, values=np.sign(wave)).regimes() == ()


def test_an_effect_that_acts_everywhere_is_drawn_over_the_coordinate_that_it_follows():
    x = np.linspace(-1.0, 1.0, 4001)
    v = np.cos(400.0 * x)
    along, units = {"x": x, "v": v}, {"x": "m", "v": "m/s"}
    dry = locate.Contribution("coulomb_friction", -np.sign(v), "N", along, units, None)
    assert dry.regimes() == ()
    assert dry.abscissa(()).label == "v, m/s"
    ends = replace(dry, values=np.maximum(np.abs(x) - 0.8, 0.0))
    assert ends.abscissa(ends.regimes()).name == "x"
    # where it is large is told by x, what it is by v
    bent = replace(dry, values=np.where(x > 0.5, 1.0, 0.3) * v)
    assert {regime.coordinate for regime in bent.regimes()} == {"x"}
    assert bent.abscissa(bent.regimes()).name == "v"


def test_a_periodic_effect_is_drawn_over_one_period():
    x = np.linspace(-1.0, 1.0, 4001)
    wave = locate.Contribution("torque_ripple[1]", np.sin(200.0 * x), "N·m", {"q_1": x}, {"q_1": "rad"}, 1)
    folded = replace(wave, period=("q_1", 2.0 * math.pi / 200.0)).abscissa(())
    assert folded.label == "q_1 modulo 0.0314, rad"
    assert np.sin(200.0 * folded.x) == pytest.approx(wave.values, abs=1e-9)


def test_correlated_residuals_count_as_fewer_samples():
    random = np.random.default_rng(2)
    white = random.standard_normal(20_000)
    slow = np.empty_like(white)
    slow[0] = white[0]
    for i in range(1, len(white)):
        slow[i] = 0.8 * slow[i - 1] + white[i]
    assert independent_samples(white[:, None]) == pytest.approx(20_000, rel=0.06)
    assert independent_samples(slow[:, None]) == pytest.approx(20_000 * 0.2 / 1.8, rel=0.15)
    assert independent_samples(np.column_stack([slow, slow])) == pytest.approx(40_000 * 0.2 / 1.8, rel=0.15)


def test_a_recording_at_rest_decides_nothing(model, acquire):
    still = acquire(DRY, 4, amplitude=0.0, duration=20.0)
    still = replace(still, inputs=np.zeros_like(still.inputs))
    answer = diagnose(model, still, still, heldout_is_test=True, baseline=BASELINE)
    assert answer.verdict == "not_decidable"
    assert (answer.missing, answer.changed, answer.excluded) == ((), (), ())
    assert {item.term for item in answer.undecided} == set(model.terms)
    assert all(item.reason == "the input never changes" for item in answer.undecided)
    check_contract(diagnosis_json(answer, SOURCES))


NUMBER = (int, float)
NULLABLE = (int, float, type(None))
PARAMETER = {
    "name": str, "value": NUMBER, "unit": str, "ci99": list, "p_value": NUMBER, "identifiable": bool,
    "term": (str, type(None)), "joint": type(None),
}  # fmt: skip
TOP = {
    "schema": str, "recordings": list, "verdict": str, "p_value": NUMBER, "p_value_method": str,
    "p_value_floor": NUMBER, "baseline": dict, "changed": list, "location": (dict, type(None)),
    "missing": list, "rivals": list, "undecided": list, "excluded": list, "improvement": dict,
    "final": dict, "curve": (dict, type(None)), "further_curves": list, "seconds": NUMBER,
}  # fmt: skip
INSIDE = {
    "recordings": {
        "path": str, "sha256": str, "rig": str, "samples": int, "duration": NUMBER, "role": str,
    },
    "changed": {
        "name": str, "joint": type(None), "before": NUMBER, "after": NUMBER, "unit": str, "ci99": list,
        "p_value": NUMBER,
    },
    "missing": {
        "term": str, "joint": type(None), "statement": str, "equation": str, "probability": NUMBER,
        "parameters": list, "evidence": dict,
    },
    "rivals": {
        "term": str, "instead_of": str, "joint": type(None), "probability": NUMBER, "delta_bic": NUMBER,
        "distinguishable": bool, "experiment": str,
    },
    "undecided": {"term": str, "joint": type(None), "needs": list, "reason": str},
    "excluded": {
        "term": str, "joint": type(None), "largest_hidden": NUMBER, "unit": str, "confidence": NUMBER,
    },
}  # fmt: skip
LOCATION = {
    "channel": str, "joint": type(None), "enters": str, "times": list, "regimes": list, "statement": str,
}  # fmt: skip
REGIME = {"coordinate": str, "low": NUMBER, "high": NUMBER, "share_of_excess": NUMBER}
EVIDENCE = {"delta_bic": NUMBER, "p_value": NUMBER, "heldout_loglik_gain": NUMBER}
FIGURES = ("rmse_before", "rmse_after", "noise_floor", "r2_before", "r2_after")
IMPROVEMENT = {
    "data": str, "metric": str, "horizon": NUMBER, "mse_before": NUMBER, "mse_after": NUMBER,
    "per_channel": list, **dict.fromkeys(FIGURES, NULLABLE),
}  # fmt: skip
CHANNEL = {"channel": str, "joint": type(None), "unit": str, **dict.fromkeys(FIGURES, NULLABLE)}
VERDICTS = {
    "no_mismatch", "parameter_change", "missing_physics", "unexplained_mismatch", "data_fault",
    "not_decidable",
}  # fmt: skip


def check(found: dict[str, Any], shape: dict[str, Any]) -> None:
    for key, kind in shape.items():
        assert key in found, f"{key} is missing among {list(found)}"
        assert isinstance(found[key], kind), f"{key}: {found[key]!r}"
        assert not (kind == NUMBER and isinstance(found[key], bool)), key


def check_contract(data: dict[str, Any]) -> None:
    """Hold a diagnosis against the public interface: keys, types, no NaN."""
    data = json.loads(json.dumps(data, allow_nan=False))
    check(data, TOP)
    assert data["schema"] == "labhil.diagnosis/1"
    assert data["verdict"] in VERDICTS
    assert data["p_value_method"] in ("bootstrap", "tail_extrapolated")
    for key, shape in INSIDE.items():
        for item in data[key]:
            check(item, shape)
    for item in data["missing"]:
        check(item["evidence"], EVIDENCE)
    for part in ("baseline", "final"):
        check(data[part], {"terms": list, "parameters": list})
    rows = data["baseline"]["parameters"] + data["final"]["parameters"]
    for row in rows + [row for item in data["missing"] for row in item["parameters"]]:
        check(row, PARAMETER)
        assert row["ci99"][0] <= row["value"] <= row["ci99"][1]
    if data["location"] is not None:
        check(data["location"], LOCATION)
        for regime in data["location"]["regimes"]:
            check(regime, REGIME)
            assert regime["low"] < regime["high"]
        assert all(len(span) == 2 for span in data["location"]["times"])
    check(data["improvement"], IMPROVEMENT)
    assert data["improvement"]["metric"] == "windowed_simulation"
    for channel in data["improvement"]["per_channel"]:
        check(channel, CHANNEL)


@pytest.mark.extended
def test_the_json_is_the_contracts(null, dry):
    for diagnosis in (null, dry):
        check_contract(diagnosis_json(diagnosis, SOURCES))


def test_numbers_that_are_not_finite_become_null(null):
    lost = replace(null.final[0], std_error=math.inf, z=math.nan, ci99=(-math.inf, math.inf))
    data = diagnosis_json(replace(null, final=[lost]), SOURCES)
    (row,) = data["final"]["parameters"]
    assert (row["std_error"], row["z"], row["ci99"]) == (None, None, [None, None])
    json.dumps(data, allow_nan=False)
    assert isinstance(lost, Estimate)


def test_too_short_a_recording_is_not_decidable(model, acquire):
    slight, test = acquire(BASELINE, 5, duration=0.9 * model.horizon), acquire(BASELINE, 6, duration=20.0)
    found = diagnose(model, slight, test, heldout_is_test=True, baseline=BASELINE)
    assert found.verdict == "not_decidable"
    assert "too short" in found.undecided[0].reason


@pytest.mark.extended
@pytest.mark.timeout(600)
@pytest.mark.parametrize("effect", ["dead_zone", pytest.param("time_delay", marks=pytest.mark.long)])
def test_one_more_effect_beside_known_dry_friction_is_named(model, acquire, effect):
    answer = diagnosed(model, acquire, (*DRY, effect), seed=50, baseline=DRY)
    named = {item.term for item in answer.missing}
    rivals = {item.term for item in answer.rivals if item.instead_of in named}
    print(effect, "→", ", ".join(sorted(named)), "| rivals:", ", ".join(sorted(rivals)) or "none")
    assert answer.verdict == "missing_physics"
    assert effect in named | rivals
    assert len(named) == 1
    assert answer.after.rmse < 1.3 * answer.after.noise_floor


@pytest.mark.extended
def test_an_effect_that_only_the_held_out_recording_shows_is_searched_there(model, acquire):
    terms = (*BASELINE, "sensor_nonlinearity")
    slight = acquire(terms, 5, amplitude=0.1, duration=40.0)
    wide = acquire(terms, 6, amplitude=0.6, frequencies=TEST_TONES, duration=60.0)
    found = diagnose(model, slight, wide, heldout_is_test=True, baseline=BASELINE)
    assert [item.term for item in found.missing] == ["sensor_nonlinearity"]
    assert found.after.rmse < 1.3 * found.after.noise_floor
    # every other quarter of the held-out recording is all that is judged on, and that is said
    assert len(found.after.recordings) == 2
    assert len(found.held_out) == pytest.approx(0.5 * len(wide), rel=0.01)
    shown = found.held_out.outputs[found.after.rows] + found.after.errors
    assert np.corrcoef(shown[:, 0], found.held_out.outputs[found.after.rows, 0])[0, 1] > 0.99
    assert "does not tell it by itself" in found.location.statement
    assert diagnosis_json(found, SOURCES)["improvement"]["parts"] is True
