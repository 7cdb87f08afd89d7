"""What disturbs a trial acts on the rig, stands in no recording, and is as strong as it is to be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.campaign.trials.answer import Answer
from labhil.campaign.trials.compose import ComposedTrial, compose_trial, make_answer
from labhil.campaign.trials.disturbance import CORRELATION_TIMES, SIZE_RANGE, Disturbance, DisturbanceKind
from labhil.campaign.trials.judge import judge
from labhil.campaign.trials.make import TrialSetOptions, answers_beside, make_trials
from labhil.campaign.trials.stated_answer import StatedAnswer
from labhil.errors import UsageError


@pytest.fixture(scope="module")
def shaken() -> ComposedTrial:
    """A motor with nothing concealed whose drive has a random force."""
    return compose_trial("dc_motor", "0", np.random.default_rng(11), 6.0, DisturbanceKind.FORCE)


@pytest.fixture(scope="module")
def answer(shaken: ComposedTrial) -> Answer:
    """Its answer."""
    return make_answer(shaken, "001", {})


def test_a_random_force_lasts_as_long_as_it_says() -> None:
    one = Disturbance(DisturbanceKind.FORCE, 2.0, 0.1, 0.0)
    factor, added = one.sample(200_000, 1e-3, 3)
    assert np.all(factor == 1.0)
    assert np.std(added) == pytest.approx(2.0, rel=0.05)
    lag = round(0.1 / 1e-3)
    assert np.mean(added[lag:] * added[:-lag]) / np.var(added) == pytest.approx(np.exp(-1.0), abs=0.05)


def test_a_gain_that_drifts_goes_through_one_swing() -> None:
    factor, added = Disturbance(DisturbanceKind.DRIFT, 0.1, 0.1, 0.0).sample(1000, 0.01, 3)
    assert not added.any()
    assert (factor.max(), factor.min()) == (pytest.approx(1.1, abs=1e-4), pytest.approx(0.9, abs=1e-4))
    assert np.sum(np.diff(np.sign(factor[1:-1] - 1.0)) != 0) == 1


def test_what_disturbs_is_as_strong_as_it_was_drawn(answer: Answer) -> None:
    low, high = (np.hypot(1.0, size) for size in SIZE_RANGE)
    assert 0.85 * low < answer.baseline_strength < 1.15 * high
    told = answer.conditions["disturbance"]
    assert told["kind"] == "force"
    assert CORRELATION_TIMES[0] <= told["lasts"] <= CORRELATION_TIMES[1]


def test_the_recorded_command_is_the_one_that_was_sent(shaken: ComposedTrial) -> None:
    calm = replace(shaken.secret, disturbance=None)
    quiet = calm.setup.simulate(calm, shaken.noise, 0)
    loop = shaken.secret.setup
    command, output = (signal.name for signal in loop.signals[:2])
    again = loop.simulate(shaken.secret, shaken.noise, 0)
    assert not np.allclose(again.signals[output], quiet.signals[output])
    silent = loop.simulate_noiseless(shaken.secret, again, 0)
    assert np.array_equal(silent.signals[command], again.signals[command])
    # without noise it is the same motion, disturbed alike
    left = again.signals[output] - silent.signals[output]
    assert np.std(left) == pytest.approx(shaken.noise.sigma[0], rel=0.1)


def test_a_mismatch_without_a_name_is_no_false_alarm_where_something_disturbs(answer: Answer) -> None:
    def never(*_: object) -> float:
        raise AssertionError

    alarms = {
        verdict: judge(answer, StatedAnswer(verdict), never).reports_mismatch
        for verdict in ("no_mismatch", "unexplained_mismatch", "missing_physics")
    }
    assert alarms == {"no_mismatch": False, "unexplained_mismatch": False, "missing_physics": True}
    calm = replace(answer, conditions={})
    assert judge(calm, StatedAnswer("unexplained_mismatch"), never).reports_mismatch
    assert not judge(calm, StatedAnswer("parameter_change"), never).reports_mismatch


@pytest.mark.parametrize(("rig", "word"), [("dc_motor", "wind"), ("ur5", "force")])
def test_what_cannot_disturb_is_refused(tmp_path: Path, rig: str, word: str) -> None:
    options = TrialSetOptions(
        rig, 1, "0", tmp_path / "set", answers_beside(tmp_path / "set"), 1, disturbed=word
    )
    with pytest.raises(UsageError, match="--disturbed: expected"):
        make_trials(options, 1, lambda text: None)
