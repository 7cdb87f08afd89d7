"""Sealed trials of an arm: what is drawn, the noise that its filter leaves, and joints in the score."""

from __future__ import annotations

import json
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from labhil.campaign.proportion import Proportion
from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.bench import bench_of
from labhil.campaign.trials.card import make_score_card
from labhil.campaign.trials.compose import compose_trial
from labhil.campaign.trials.folder import STEPWISE
from labhil.campaign.trials.judge import judge
from labhil.campaign.trials.make import TrialSetOptions, answers_beside, make_trials
from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.run import run_trials
from labhil.campaign.trials.score import score_trials
from labhil.campaign.trials.seal import open_envelope, write_envelope
from labhil.campaign.trials.secret import Secret
from labhil.campaign.trials.show import show
from labhil.campaign.trials.stated_answer import parse_stated_answer
from labhil.campaign.trials.truth import model_values
from labhil.diagnose.contradiction import structure_p_value
from labhil.identify.fitted import fit_terms
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.windows import noise_of
from labhil.physics.arm.motion import LowPass
from labhil.physics.rigs import model_for
from labhil.rig import parse_rig

BASELINE = ("viscous_friction", "coulomb_friction", "sensor_offset")
NOISE = TrueNoise((0.02,) * 6, (0.001,) * 6, 0.5)


def silent(text):
    return None


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return model_for(parse_rig(bench_of("ur5").rig, tmp_path_factory.mktemp("rig") / "ur5.toml"))


def drawn(seed, model, trial_type="1"):
    """A setup, its baseline's numbers, and the first effect of that seed."""
    rng = np.random.default_rng(seed)
    setup = bench_of("ur5").draw_setup(rng)
    base = setup.draw_baseline_parameters(rng)
    return setup, base, setup.draw_effect(model, trial_type == "hidden", [], rng)


def true_effect(term, joint, catalogue=True):
    return TrueEffect(term, joint, catalogue, {}, {}, 3.0, 100.0)


def answer(*effects):
    floors = {f"actual_current_{j}": 0.01 for j in range(6)}
    return Answer("001", "ur5", {}, BASELINE, effects, {}, NOISE, floors, 1.0, {}, {})


def said(*claims):
    missing = [{"term": term, "joint": joint, "probability": 0.9} for term, joint in claims]
    located = {"joint": claims[0][1], "regimes": []}
    return parse_stated_answer(
        {
            "schema": "labhil.diagnosis/1",
            "verdict": "missing_physics",
            "missing": missing,
            "rivals": [],
            "final": {"terms": [], "parameters": []},
            "improvement": None,
            "location": located,
            "seconds": 1.0,
        }
    )


def test_effects_are_drawn_for_one_joint_or_for_the_whole_arm(model):
    effects = [drawn((seed, 0), model)[2] for seed in range(60)]
    whole = {effect.term for effect in effects if effect.joint is None}
    assert whole == {"payload", "base_tilt", "clock_offset"}
    assert {effect.joint for effect in effects} == {None, *range(6)}
    assert all(effect.key in model.terms for effect in effects)
    assert not {"constant_force", "static_friction", "viscous_friction"} & {e.term for e in effects}
    for effect in effects:
        ends = {name[-3:] for name in effect.parameters}
        assert effect.joint is None or ends == {f"[{effect.joint}]"}


def test_hidden_effects_of_an_arm_stand_in_no_list(model):
    effects = [drawn((seed, 1), model, "hidden")[2] for seed in range(12)]
    assert {effect.term for effect in effects} == {"hidden_cable", "hidden_sticky_patch"}
    assert all((effect.joint is None) == (effect.term == "hidden_cable") for effect in effects)


def test_what_a_plant_is_made_of_is_what_its_model_calls_it(model):
    setup, base, effect = drawn((4, 0), model)
    assert effect.key == "torque_constant[0]"
    numbers = setup.plant_parameters(Secret(setup, base, (effect.scaled(2.0),)))
    values = model_values(model, numbers)
    gain = 2.0 * effect.parameters["sensor_gain.gain[0]"]
    assert values["torque_constant.gain[0]"] == pytest.approx(gain)
    assert values["torque_constant.gain[1]"] == 0.0
    assert values["coulomb_friction.level[3]"] == base["coulomb_friction.level[3]"]


def test_a_stronger_effect_keeps_its_shape(model):
    effect = next(e for s in range(60) if (e := drawn((s, 0), model)[2]).term == "payload")
    twice = effect.scaled(2.0)
    assert twice.parameters["payload.mass"] == pytest.approx(2.0 * effect.parameters["payload.mass"])
    assert twice.parameters["payload.centre_z"] == effect.parameters["payload.centre_z"]
    bristles = next(e for s in range(60) if (e := drawn((s, 0), model)[2]).term == "presliding_friction")
    key = f"presliding_friction.stiffness[{bristles.joint}]"
    assert bristles.scaled(2.0).parameters[key] == pytest.approx(0.5 * bristles.parameters[key])


def test_an_effect_of_a_joint_keeps_it_in_its_envelope(tmp_path):
    told = answer(true_effect("load_dependent_friction", 1), true_effect("payload", None))
    sealed = write_envelope(told.to_json(), tmp_path / "001.json")
    opened = Answer.from_json(open_envelope(tmp_path / "001.json", sealed))
    assert opened == told
    assert [effect.key for effect in opened.effects] == ["load_dependent_friction[1]", "payload"]
    assert json.dumps(opened.to_json(), allow_nan=False)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_noise_after_a_filter_is_as_it_is_computed(correlation):
    low_pass, rng = LowPass(9.0, 0.008), np.random.default_rng(1)
    noise = rng.standard_normal((2500, 200))
    for k in range(1, len(noise)):
        noise[k] = correlation * noise[k - 1] + np.sqrt(1.0 - correlation**2) * noise[k]
    passed = low_pass(noise)[200:-200]
    stated = low_pass.autocovariance(40, correlation)
    for apart in (0, 3, 6, 11):
        found = float(np.mean(passed[: len(passed) - apart] * passed[apart:]))
        assert found == pytest.approx(stated[apart], abs=0.03 * stated[0])


def test_the_right_name_in_the_wrong_joint_is_wrong():
    truth = answer(true_effect("load_dependent_friction", 1))
    right, wrong = (judge(truth, said(("load_dependent_friction", j)), lambda e, r: 0.0) for j in (1, 2))
    assert right.exact
    assert not wrong.exact
    assert wrong.confusions == (("load_dependent_friction[1]", "load_dependent_friction[2]"),)
    card = make_score_card([right, wrong], "ur5", True)
    assert card.right_joints == Proportion(1, 2)
    assert card.to_json()["right_joint"] == card.right_joints.to_json()


def test_what_has_no_name_has_to_be_found_in_its_joint():
    truth = answer(true_effect("hidden_sticky_patch", 2, catalogue=False))
    here, there = (judge(truth, said(("unmodelled_force", j)), lambda e, r: 0.0) for j in (2, 4))
    assert here.exact
    assert not there.exact


def test_what_pulls_at_several_joints_may_have_a_curve_on_each_of_them():
    truth = answer(true_effect("hidden_cable", None, catalogue=False))
    several = said(("unmodelled_force", 3), ("unmodelled_force", 5))
    with_a_name = said(("unmodelled_force", 3), ("friction_asymmetry", 5))
    assert judge(truth, several, lambda e, r: 0.0).exact
    assert not judge(truth, with_a_name, lambda e, r: 0.0).exact


def test_a_confusion_of_joints_is_printed_pair_by_pair():
    pairs = [(f"stribeck_friction[{j}]", f"{term}[{j}]") for j in range(6) for term in ("a", "b", "c")]
    card = make_score_card([judge(answer(), said(("a", 0)), lambda e, r: 0.0)], "ur5", True)
    out = StringIO()
    show(replace(card, confusion=dict.fromkeys(pairs, 2)), Console(file=out, width=80))
    lines = [line.split() for line in out.getvalue().splitlines()]
    assert ["stribeck_friction[5]", "c[5]", "2"] in lines


@pytest.fixture(scope="module")
def null():
    """An arm without any concealed effect."""
    return compose_trial("ur5", "0", np.random.default_rng((6, 0)))


def test_the_noise_of_an_arm_is_read_from_what_its_model_leaves(null):
    oracle = null.oracle
    refit = oracle.refit(BASELINE)
    stated = estimate_coloured_noise(oracle.model, refit.theta, oracle.test, noise_of(oracle.test)).sigma
    assert stated == pytest.approx(oracle.residual_noise.rms, rel=0.15)


def test_structure_is_looked_for_across_windows_without_states(null):
    oracle = null.oracle
    window = 0.375 * oracle.model.horizon
    fitted = fit_terms(oracle.model, oracle.search, BASELINE, window, oracle.sigma)
    residuals = fitted.solution.residuals
    _, _, jacobian = fitted.covariances
    found = structure_p_value(fitted.problem, fitted.solution.point, residuals, jacobian)
    # a window is shorter than the autoregression that whitens it
    assert np.isfinite(found).all()
    assert min(found) > 5e-4


def test_the_truth_leaves_noise_as_it_is_known(null):
    found, oracle = null, null.oracle
    refit = oracle.refit(BASELINE)
    marks = [oracle.strength(refit.theta, joint) for joint in range(6)]
    assert marks == pytest.approx([1.0] * 6, abs=0.15)
    assert oracle.strength(refit.theta) == pytest.approx(np.mean(marks))
    # of white noise of as many samples as are judged
    judged = np.count_nonzero(oracle.residual_noise.judged)
    assert -2.0 * oracle.log_likelihood(refit.theta) == pytest.approx(judged, rel=0.1)
    setup, secret = found.secret.setup, found.secret
    record = setup.to_record(setup.simulate_noiseless(secret, found.runs[1], 1))
    assert -2.0 * oracle.log_likelihood_of_truth(refit.theta, record) == pytest.approx(judged, rel=0.1)


@pytest.mark.extended
@pytest.mark.timeout(400)
def test_three_trials_of_an_arm_from_drawing_to_score(tmp_path):
    """A null, an effect of one joint, a payload."""
    cards = {}
    for name, trial_type, seed in (("null", "0", 6), ("joint", "1", 20), ("payload", "1", 29)):
        folder = tmp_path / name
        options = TrialSetOptions("ur5", 1, trial_type, folder, answers_beside(folder), seed)
        make_trials(options, 1, silent)
        run_trials(folder, 1, silent)
        cards[name] = score_trials(folder, options.answers, silent)
    # a method that does not say where an effect is
    run_trials(folder, 1, silent, STEPWISE)
    stepwise = score_trials(folder, options.answers, silent, STEPWISE)
    assert (stepwise.trials, stepwise.failures) == (1, 0)
    assert stepwise.right_joints == Proportion(0, 0)
    assert cards["null"].false_alarms == Proportion(0, 1)
    assert cards["joint"].confusion == {("torque_constant[3]", "torque_constant[3]"): 1}
    assert cards["joint"].right_joints == Proportion(1, 1)
    assert cards["payload"].confusion == {("payload", "payload"): 1}
    assert cards["payload"].naming["one effect"]["any"] == Proportion(1, 1)
