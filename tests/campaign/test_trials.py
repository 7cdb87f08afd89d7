"""Sealed trials: what is drawn and sealed, what a run leaves, and the arithmetic of the score."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import count as count_up
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from labhil.campaign.proportion import Proportion
from labhil.campaign.trials import run
from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.bench import bench_of
from labhil.campaign.trials.card import make_score_card, reliability_bins
from labhil.campaign.trials.compose import compose_trial, record_secret
from labhil.campaign.trials.folder import Results, read_index
from labhil.campaign.trials.judge import judge
from labhil.campaign.trials.make import TrialSetOptions, answers_beside, make_trial, make_trials
from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.plot import plot
from labhil.campaign.trials.regime import intersection_over_union, samples_in_regimes, smallest_level_set
from labhil.campaign.trials.run import run_trials
from labhil.campaign.trials.score import score_trials
from labhil.campaign.trials.seal import open_envelope, seal, write_envelope
from labhil.campaign.trials.secret import DrawnEffect, Secret
from labhil.campaign.trials.stated_answer import Regime, parse_stated_answer
from labhil.command_line import app
from labhil.errors import UnknownNameError, UsageError
from labhil.identify.fitted import fit_by_continuation, start_theta
from labhil.identify.window_states import estimate_states_at
from labhil.identify.windows import fit_windows
from labhil.physics.rigs import rig_model
from labhil.recording.reader import read_recording
from labhil_benchmarks.trials.calibrate import claimed_in
from labhil_benchmarks.trials.stepwise import log_ways

SIMULATORS = Path(__file__).parents[2] / "benchmarks" / "simulators"
NOTHING = {
    "schema": "labhil.diagnosis/1",
    "verdict": "no_mismatch",
    "missing": [],
    "rivals": [],
    "final": {"terms": ["viscous_friction"], "parameters": []},
    "improvement": None,
    "location": None,
    "seconds": 1.0,
}


def silent(text):
    return None


def lossless(effect, rival):
    return 0.0


def one_item(term, probability=0.9):
    return {"term": term, "joint": None, "probability": probability}


def rival(term, instead_of, probability=0.1):
    return {"term": term, "instead_of": instead_of, "joint": None, "probability": probability}


def said(*terms, verdict="missing_physics", rivals=(), **more):
    items = [one_item(term) for term in terms]
    final = {"terms": ["viscous_friction", *terms], "parameters": more.pop("parameters", [])}
    return parse_stated_answer(
        {**NOTHING, "verdict": verdict, "missing": items, "rivals": list(rivals), "final": final, **more}
    )


def effect(term, gain=100.0, strength=2.0, catalogue=True):
    return TrueEffect(term, None, catalogue, {}, {}, strength, gain)


def answer(*effects, truth=None):
    noise = TrueNoise((1.0,), (0.0,), 0.0)
    floors = {"ball_position": 0.001}
    return Answer(
        "001", "ball_beam", {}, ("viscous_friction",), effects, truth or {}, noise, floors, 1.0, {}, {}
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trials") / "set"
    options = TrialSetOptions("ball_beam", 1, "1", folder, answers_beside(folder), seed=2)
    folder.mkdir()
    options.answers.mkdir()
    return options, make_trial(options, "001", (2,))


def test_a_seed_makes_the_same_trial_again():
    first, second = (compose_trial("ball_beam", "0", np.random.default_rng((4, 0))) for _ in range(2))
    assert first.secret == second.secret
    for one, other in zip(first.runs, second.runs, strict=True):
        assert np.array_equal(one.signals["ball_position"], other.signals["ball_position"])


def test_an_answer_tells_what_each_effect_is_worth(made):
    options, entry = made
    found = Answer.from_json(open_envelope(options.answers / "001.json", entry.seal))
    assert len(found.effects) == 1
    assert found.effects[0].strength > 1.0
    assert found.recordings == entry.recordings
    assert Answer.from_json(json.loads(json.dumps(found.to_json()))) == found


def test_a_recording_tells_nothing_of_the_secret(made):
    options, _ = made
    recording = read_recording(options.out / "001" / "search.mcap")
    assert recording.rig is not None
    assert set(recording.metadata) == {"end"}
    assert set(recording.attachments) == {"rig.toml"}


def test_a_changed_answer_is_refused(tmp_path):
    path = tmp_path / "001.json"
    stated = write_envelope({"effects": []}, path)
    assert open_envelope(path, stated) == {"effects": []}
    data = json.loads(path.read_text())
    path.write_text(json.dumps({**data, "answer": {"effects": ["viscous"]}}))
    with pytest.raises(UsageError, match="seal does not match"):
        open_envelope(path, stated)


def test_a_seal_hangs_on_its_nonce():
    assert seal({"a": 1}, b"0" * 32) != seal({"a": 1}, b"1" * 32)
    assert seal({"a": 1, "b": 2}, b"0" * 32) == seal({"b": 2, "a": 1}, b"0" * 32)


@pytest.mark.parametrize(
    ("changed", "error"),
    [
        ({"kind": "balloon"}, UnknownNameError),
        ({"trials": 0}, UsageError),
        ({"first": 0}, UsageError),
        ({"trial_type": "4"}, UsageError),
    ],
)
def test_a_wrong_order_is_refused(tmp_path, changed, error):
    given = {"kind": "axis", "trials": 1, "trial_type": "1", "out": tmp_path / "a", "answers": tmp_path / "b"}
    with pytest.raises(error):
        make_trials(TrialSetOptions(**{**given, **changed}), 1, silent)


def test_answers_within_reach_of_a_diagnosis_are_refused(tmp_path):
    with pytest.raises(UsageError, match="outside"):
        make_trials(TrialSetOptions("axis", 1, "1", tmp_path / "a", tmp_path / "a" / "answers"), 1, silent)


@pytest.mark.extended
def test_a_trial_is_the_same_bytes_however_long_a_loaded_machine_takes(tmp_path, monkeypatch):
    options = TrialSetOptions("axis", 1, "0", tmp_path / "a", tmp_path / "b", 4)
    at_once = make_trials(options, 1, silent)
    hours = count_up(step=3600.0)
    monkeypatch.setattr("labhil.recording.writer.time.monotonic", lambda: next(hours))
    late = make_trials(replace(options, out=tmp_path / "c", answers=tmp_path / "d"), 1, silent)
    assert late.trials[0].recordings == at_once.trials[0].recordings


@pytest.mark.extended
def test_making_goes_on_where_it_was_interrupted(tmp_path):
    out, answers = tmp_path / "a", tmp_path / "b"
    options = TrialSetOptions("axis", 1, "0", out, answers, 4, resume=True)
    first = make_trials(options, 1, silent)
    (out / "002").mkdir()
    (out / "002" / "search.mcap.part").write_bytes(b"half")
    both = make_trials(replace(options, trials=2), 1, silent)
    assert [entry.name for entry in both.trials] == ["001", "002"]
    assert both.trials[0] == first.trials[0]
    assert not (out / "002" / "search.mcap.part").exists()
    later = make_trials(
        TrialSetOptions("axis", 1, "0", tmp_path / "c", tmp_path / "d", 4, first=2), 1, silent
    )
    assert later.trials == both.trials[1:]
    with pytest.raises(UsageError, match="found 2 of axis"):
        make_trials(options, 1, silent)
    with pytest.raises(UsageError, match="drawn from randomness"):
        make_trials(replace(options, trials=2, seed=None), 1, silent)


@pytest.fixture
def listed_set(tmp_path):
    """A set of two trials whose recordings nobody reads, with their answers."""
    folder, answers = tmp_path / "set", tmp_path / "set-answers"
    answers.mkdir()
    trials = []
    for name in ("001", "002"):
        (folder / name).mkdir(parents=True)
        sealed = write_envelope({**answer().to_json(), "trial": name}, answers / f"{name}.json")
        trials.append({"name": name, "seal": sealed, "recordings": {}})
    index = {"schema": "labhil.trials/1", "rig": "ball_beam", "fixed_seed": True, "trials": trials}
    (folder / "trials.json").write_text(json.dumps(index))
    return folder, answers


@pytest.fixture
def here(monkeypatch):
    """Diagnoses in this process, by a stand-in that counts what it was asked."""
    asked = []

    def diagnose_all(results, names, hashes, jobs, progress):
        for name in names:
            asked.append(name)
            path = results.path_of(name)
            path.write_text(json.dumps(NOTHING))
            hashes[name] = run.sha256_of(path)
            results.write_hashes(hashes)

    monkeypatch.setattr(run, "_diagnose_all", diagnose_all)
    return asked


def test_a_run_goes_on_where_it_was_interrupted(listed_set, here):
    folder, answers = listed_set
    first = run_trials(folder, 1, silent)
    assert here == ["001", "002"]
    lines = (folder / "results.sha256").read_text().splitlines()
    (folder / "results.sha256").write_text(lines[0] + "\n")
    assert run_trials(folder, 1, silent) == first
    assert here == ["001", "002", "002"]
    assert score_trials(folder, answers, silent).false_alarms == Proportion(0, 2)
    assert claimed_in(folder) == []


def test_methods_answer_the_same_trials_beside_each_other(listed_set, here):
    folder, answers = listed_set
    run_trials(folder, 1, silent, "stepwise")
    with pytest.raises(UsageError, match="expected results of 2 trials, found 0"):
        score_trials(folder, answers, silent)
    assert score_trials(folder, answers, silent, "stepwise").false_alarms == Proportion(0, 2)
    with pytest.raises(UnknownNameError, match="--method"):
        run_trials(folder, 1, silent, "guess")


def test_each_simulator_has_results_of_its_own(tmp_path):
    names = [Results(tmp_path, f"sims/{name}").name for name in ("cart.py:cart", "cart.xml", "cart.fmu")]
    assert names == ["results-cart.py-cart", "results-cart.xml", "results-cart.fmu"]
    with pytest.raises(UnknownNameError, match="--method"):
        Results(tmp_path, "cart.py")


@pytest.mark.extended
@pytest.mark.parametrize("simulator", ["cart.py:cart", pytest.param("cart.xml", marks=pytest.mark.long)])
def test_a_simulator_of_a_users_own_names_what_is_concealed(tmp_path, simulator):
    folder = tmp_path / "set"
    options = TrialSetOptions("axis", 1, "1", folder, answers_beside(folder), 4)
    make_trials(options, 1, silent)
    method = str(SIMULATORS / simulator)
    run_trials(folder, 1, silent, method)
    card = score_trials(folder, options.answers, silent, method)
    assert (card.trials, card.failures) == (1, 0)
    assert sum(card.confusion.values()) == 1


def test_the_extended_criterion_counts_the_ways_to_choose():
    for possible, chosen in [(20, 0), (20, 1), (20, 3), (7, 7)]:
        assert log_ways(possible, chosen) == pytest.approx(math.log(math.comb(possible, chosen)), abs=1e-9)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("kind", "first"),
    [
        # balls that hardly move, read in steps of ten times the noise; the floor of white noise is too low
        ("ball_beam", 508), ("ball_beam", 700),
        # a plunger whose mass the first windows do not show: it went to its bound and stayed
        ("solenoid", 649),
        # a plunger that rests at its stops, where the same rounding comes back: half a per cent of the error
        ("solenoid", 768),
    ],
)  # fmt: skip
def test_no_alarm_is_raised_where_noise_is_not_what_it_is_taken_for(tmp_path, kind, first):
    folder = tmp_path / "set"
    options = TrialSetOptions(kind, 1, "0", folder, answers_beside(folder), 94, first=first)
    make_trials(options, 1, silent)
    run_trials(folder, 1, silent)
    assert score_trials(folder, options.answers, silent).false_alarms.hits == 0


@pytest.mark.long
def test_forward_steps_name_a_strong_effect_and_are_scored(tmp_path):
    folder = tmp_path / "set"
    options = TrialSetOptions("axis", 3, "1", folder, answers_beside(folder), 4)
    make_trials(options, 2, silent)
    run_trials(folder, 2, silent, "stepwise")
    card = score_trials(folder, options.answers, silent, "stepwise")
    assert (card.trials, card.failures) == (3, 0)
    assert sum(card.confusion.values()) >= 3


@pytest.mark.long
def test_the_benchmark_counts_nulls_and_effects_together(tmp_path):
    given = ["trial", "benchmark", "axis", "--trials", "1", "--seed", "3", "-o", str(tmp_path / "all")]
    path = tmp_path / "score.json"
    for _ in range(2):
        done = CliRunner().invoke(app, [*given, "--json", str(path)])
        assert done.exit_code == 0, done.output
    score = json.loads(path.read_text())
    assert (score["trials"], score["failures"], score["false_alarms"]["of"]) == (2, 0, 1)


def test_a_changed_result_is_refused(listed_set, here):
    folder, answers = listed_set
    run_trials(folder, 1, silent)
    (folder / "results" / "001.json").write_text(json.dumps({**NOTHING, "verdict": "missing_physics"}))
    with pytest.raises(UsageError, match="not the result that was hashed"):
        score_trials(folder, answers, silent)
    with pytest.raises(UsageError, match="is not the result"):
        run_trials(folder, 1, silent)


def test_a_set_that_is_not_all_diagnosed_is_not_scored(listed_set):
    with pytest.raises(UsageError, match="expected results of 2 trials, found 0"):
        score_trials(*listed_set, silent)


def test_a_failing_diagnosis_is_recorded(tmp_path):
    result = run.diagnose_trial(tmp_path, "001")
    assert result["verdict"] is None
    assert "RecordingError" in result["error"]
    assert parse_stated_answer(result).verdict is None


def test_a_diagnosis_opens_no_envelope(tmp_path):
    path = tmp_path / "001.json"
    with pytest.raises(PermissionError, match="opens no envelopes"):
        run._refuse_envelopes("open", (str(path), "r", 0))
    run._refuse_envelopes("open", (str(tmp_path / "search.mcap"), "r", 0))


def test_one_effect_named_alone_is_an_exact_and_single_answer():
    j = judge(answer(effect("dead_zone")), said("dead_zone"), lossless)
    assert j.exact
    assert j.unrivalled
    assert j.confusions == (("dead_zone", "dead_zone"),)
    assert j.claims == ((0.9, True),)


def test_a_pair_is_honest_only_while_its_rival_explains_the_data():
    pair = said("time_delay", rivals=[rival("dead_zone", "time_delay")])
    truth = answer(effect("dead_zone"))
    near, far = judge(truth, pair, lossless), judge(truth, pair, lambda effect, rival: 5.0)
    assert near.exact
    assert not near.unrivalled
    assert not far.exact
    assert near.claims == ((0.9, False), (0.1, True))


def test_two_effects_need_both_names_and_nothing_else():
    truth = answer(effect("dead_zone"), effect("time_delay"))
    assert judge(truth, said("time_delay", "dead_zone"), lossless).exact
    assert not judge(truth, said("time_delay"), lossless).exact
    three = judge(truth, said("time_delay", "dead_zone", "backlash"), lossless)
    assert not three.exact
    assert ("none", "backlash") in three.confusions


def test_a_small_effect_may_be_named_or_not():
    truth = answer(effect("dead_zone"), effect("time_delay", gain=5.0))
    assert judge(truth, said("dead_zone"), lossless).exact
    assert judge(truth, said("dead_zone", "time_delay"), lossless).exact
    tiny = answer(effect("dead_zone"), effect("time_delay", gain=1.0))
    assert not judge(tiny, said("dead_zone", "time_delay"), lossless).exact


def test_a_null_is_what_the_oracle_does_not_tell_either():
    null = answer(effect("dead_zone", gain=2.9))
    judged = [
        judge(null, said("dead_zone"), lossless),
        judge(null, said(verdict="no_mismatch"), lossless),
        judge(null, said(verdict="not_decidable"), lossless),
    ]
    card = make_score_card([*judged, judge(answer(), said("dead_zone"), lossless)], "ball_beam", False)
    assert card.false_alarms == Proportion(3, 4)
    assert card.false_alarms_when_empty == Proportion(1, 1)
    assert card.unrivalled.total == 0


def test_exact_answers_with_rivals_are_counted_apart():
    pair = said("dead_zone", rivals=[rival("time_delay", "dead_zone")])
    truth = answer(effect("dead_zone", strength=3.5))
    card = make_score_card(
        [judge(truth, each, lossless) for each in (pair, said("dead_zone"))], "ball_beam", False
    )
    assert card.naming["one effect"]["full"] == Proportion(2, 2)
    assert card.naming_unrivalled["one effect"]["full"] == Proportion(1, 2)


def test_between_three_and_ten_nats_only_detection_counts():
    j = judge(answer(effect("dead_zone", gain=6.0, strength=1.2)), said(verdict="not_decidable"), lossless)
    card = make_score_card([j], "ball_beam", False)
    assert card.false_alarms.total == 0
    assert card.naming["one effect"]["any"].total == 0
    assert card.detection["1.1 to 1.3"] == Proportion(0, 1)
    assert card.confusion == {}


def test_what_no_name_fits_is_right_as_unmodelled():
    truth = answer(effect("hidden_magnet", catalogue=False))
    assert judge(truth, said("unmodelled_force"), lossless).exact
    assert judge(truth, said(verdict="unexplained_mismatch"), lossless).exact
    wrong = judge(truth, said("spring_force"), lossless)
    assert wrong.confusions == (("outside the catalogue", "spring_force"),)
    assert not wrong.exact


def test_a_failure_counts_as_nothing_found():
    failed = parse_stated_answer({"verdict": None, "error": "KeyError", "seconds": 1.0})
    card = make_score_card([judge(answer(effect("dead_zone")), failed, lossless)], "ball_beam", False)
    assert card.failures == 1
    assert card.naming["one effect"]["any"] == Proportion(0, 1)
    assert card.confusion == {("dead_zone", "failed"): 1}


def test_errors_are_measured_against_the_true_floor():
    channel = {"channel": "ball_position", "joint": None, "rmse_before": 0.003, "rmse_after": 0.0011}
    told = said("dead_zone", improvement={"per_channel": [channel]})
    j = judge(answer(effect("dead_zone")), told, lossless)
    assert j.after_over_floor == pytest.approx(1.1)
    assert j.modelled
    worse = said("dead_zone", improvement={"per_channel": [{**channel, "rmse_after": 0.002}]})
    assert judge(answer(effect("dead_zone")), worse, lossless).modelled is False


def test_intervals_count_where_the_model_is_complete():
    row = {"name": "viscous_friction.coefficient", "joint": None, "ci99": [0.1, 0.3]}
    truth = {"viscous_friction.coefficient": 0.2}
    full = judge(answer(effect("dead_zone"), truth=truth), said("dead_zone", parameters=[row]), lossless)
    short = judge(answer(effect("backlash"), truth=truth), said("dead_zone", parameters=[row]), lossless)
    card = make_score_card([full, short], "ball_beam", False)
    assert (card.coverage, card.coverage_incomplete) == (Proportion(1, 1), Proportion(1, 1))


def test_a_regime_is_the_smallest_set_that_holds_four_fifths_of_the_excess():
    own, excess = np.array([0.0, 1.0, 5.0, 4.0, 3.0]), np.array([0.1, 0.1, 4.0, 4.0, 1.0])
    true = smallest_level_set(own, excess)
    assert true is not None
    assert true.tolist() == [False, False, True, True, False]
    told = samples_in_regimes({"v": np.arange(5.0)}, [Regime("v", 2.0, 2.5)])
    assert intersection_over_union(true, told) == pytest.approx(0.5)
    own_force = samples_in_regimes({"ripple": np.arange(-2.0, 3.0)}, [Regime("ripple", 0.5, 1.5)], "ripple")
    assert own_force.tolist() == [False, False, False, True, True]
    assert smallest_level_set(own, np.ones(5)) is None


def test_reliability_is_counted_in_tenths():
    claims = [(0.95, True)] * 9 + [(0.95, False), (1.0, True)]
    (row,) = reliability_bins(claims)
    assert row.right == Proportion(10, 11)
    card = make_score_card(
        [judge(answer(effect("backlash")), said("dead_zone"), lossless)], "ball_beam", False
    )
    assert card.calibration_error == pytest.approx(0.9)
    assert json.dumps(card.to_json(), allow_nan=False)


def test_answers_are_counted_by_strength_and_every_trial_is_told():
    weak, full = (answer(effect("dead_zone", strength=strength)) for strength in (1.4, 4.0))
    judged = [
        judge(weak, said(verdict="not_decidable"), lossless),
        judge(full, said("dead_zone"), lossless),
        judge(full, said("backlash"), lossless),
    ]
    card = make_score_card(judged, "ball_beam", False)
    assert card.undecided == Proportion(1, 3)
    assert (card.named["1.3 to 1.6"], card.named["3 to 5"]) == (Proportion(0, 1), Proportion(1, 2))
    first, _, sort_key = card.to_json()["each"]
    assert (first["verdict"], first["effects"]) == ("not_decidable", [["dead_zone", 1.4, 100.0]])
    assert sort_key["named"] == [["dead_zone", "backlash"]]


def test_a_score_is_drawn(tmp_path):
    judged = [judge(answer(effect("dead_zone")), said("backlash"), lossless)]
    path = tmp_path / "score.png"
    plot(make_score_card(judged, "ball_beam", False), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    plot(make_score_card([], "ball_beam", False), path)
    with pytest.raises(UsageError, match="cannot be written"):
        plot(make_score_card(judged, "ball_beam", False), tmp_path / "score.nothing")


def test_score_cards_stand_side_by_side(tmp_path):
    truth = answer(effect("dead_zone", strength=4.0))
    names = {"right": "dead_zone", "wrong": "backlash"}
    for name, term in names.items():
        card = make_score_card([judge(truth, said(term), lossless)], "ball_beam", False)
        (tmp_path / f"{name}.json").write_text(json.dumps(card.to_json()))
    done = CliRunner().invoke(app, ["trial", "compare", *(str(tmp_path / f"{name}.json") for name in names)])
    table = [line.split(" | ") for line in done.output.splitlines()]
    assert table[0] == ["|", "`right`", "`wrong` |"]
    exact = next(row for row in table if row[0] == "| one effect, exact, strength 3 or more")
    assert (exact[1].split(";")[0], exact[2].split(";")[0]) == ("100 % (1 of 1", "0 % (0 of 1")
    (tmp_path / "right.json").write_text("{}")
    refused = CliRunner().invoke(app, ["trial", "compare", str(tmp_path / "right.json")])
    assert isinstance(refused.exception, UsageError)


def test_the_commands_explain_themselves(tmp_path):
    for name in ("make", "run", "score", "benchmark", "compare"):
        shown = CliRunner().invoke(app, ["trial", name, "--help"])
        assert shown.exit_code == 0
        assert "Example: labhil trial" in shown.output
    missing = CliRunner().invoke(app, ["trial", "run", str(tmp_path)])
    assert isinstance(missing.exception, UsageError)


def test_a_set_made_by_the_command_says_that_its_seed_is_fixed(tmp_path):
    out = tmp_path / "set"
    options = ["trial", "make", "--rig", "ball_beam", "--trials", "1", "--effects", "0", "-o", str(out)]
    done = CliRunner().invoke(app, [*options, "--seed", "2", "--jobs", "1"])
    assert done.exit_code == 0, done.output
    assert "fixed seed" in done.output
    index = read_index(out)
    assert index.fixed_seed
    assert (
        Answer.from_json(open_envelope(tmp_path / "set-answers" / "001.json", index.trials[0].seal)).effects
        == ()
    )


@pytest.mark.extended
def test_an_oracle_learns_from_whole_recordings():
    rng = np.random.default_rng(7)
    oracle = compose_trial("axis", "0", rng).oracle
    baseline = rig_model("axis").baseline
    refit = oracle.refit(baseline)
    truth = start_theta(oracle.model, oracle.values)
    lengths = [0.5 * oracle.horizon, 1.5 * oracle.horizon]
    cut = fit_by_continuation(
        oracle.model, oracle.search, baseline, lengths, oracle.sigma, start=truth, new_terms=()
    )[-1]
    assert refit.likelihood > oracle.log_likelihood(cut.theta)
    # four parameters, each worth half a nat on average, of noise with neighbours that are alike
    assert refit.likelihood > oracle.log_likelihood(truth) - 20.0


@pytest.mark.extended
@pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.extended) for seed in (0, 3)), 4, 8])
def test_an_oracle_finds_the_right_minimum_of_a_ball_that_sticks(seed):
    rng = np.random.default_rng(seed)
    setup = bench_of("ball_beam").draw_setup(rng)
    bare = Secret(setup, setup.draw_baseline_parameters(rng))
    sticks = DrawnEffect(
        "static_friction", {"static_friction.level": 0.08}, {"static_friction.level": 1}, 3.0
    )
    oracle = record_secret(replace(bare, effects=(sticks,)), setup.true_noise(bare)).oracle
    truth = oracle.log_likelihood(start_theta(oracle.model, oracle.values))
    baseline = rig_model("ball_beam").baseline
    assert oracle.refit([*baseline, "static_friction"]).likelihood > truth - 30.0
    assert oracle.refit(baseline).likelihood < truth - 300.0


@pytest.mark.extended
def test_a_rig_stands_at_the_centre_of_its_excitation_before_it_is_recorded():
    rng = np.random.default_rng(3)
    setup = bench_of("solenoid").draw_setup(rng)
    bare = Secret(setup, setup.draw_baseline_parameters(rng))
    delay = DrawnEffect("time_delay", {"time_delay.delay": 0.012}, {"time_delay.delay": 1}, 3.0)
    oracle = record_secret(replace(bare, effects=(delay,)), setup.true_noise(bare)).oracle
    # what a delay holds as a recording begins is as recorded: else the first window is off by far more
    theta, windows = start_theta(oracle.model, oracle.values), fit_windows(oracle.search, oracle.horizon)
    found = estimate_states_at(oracle.model, theta, oracle.search, windows, oracle.sigma)
    assert np.sqrt(np.mean(found.residuals**2)) < 2.0


@pytest.mark.extended
@pytest.mark.parametrize(("rig", "period"), [("solenoid", 1e-3), ("ball_beam", 0.01)])
def test_recordings_are_as_long_as_they_are_ordered(tmp_path, rig, period):
    make_trials(
        TrialSetOptions(rig, 1, "0", tmp_path / "set", tmp_path / "answers", seed=5, seconds=6.0), 1, str
    )
    for role in ("search", "test"):
        t = read_recording(tmp_path / "set" / "001" / f"{role}.mcap").streams[0].t
        assert t[-1] - t[0] == pytest.approx(6.0, abs=2.0 * period)


def test_a_recording_of_no_length_is_refused(tmp_path):
    options = TrialSetOptions("axis", 1, "0", tmp_path / "set", tmp_path / "answers", seconds=0.5)
    with pytest.raises(UsageError, match=r"--seconds: expected at least 2, found 0\.5"):
        make_trials(options, 1, str)
