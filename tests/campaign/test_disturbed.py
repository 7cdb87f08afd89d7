"""What disturbs a trial acts on the rig, stands in no recording, and is as strong as it is to be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.campaign.trials.answer import Answer
from labhil.campaign.trials.compose import Composed, answer_of, compose
from labhil.campaign.trials.disturbed import LASTS, SIZES, Disturbance, Kind
from labhil.campaign.trials.judge import judge
from labhil.campaign.trials.make import Order, answers_beside, make_trials
from labhil.campaign.trials.stated_answer import StatedAnswer
from labhil.errors import UsageError


@pytest.fixture(scope="module")
def shaken() -> Composed:
    """A motor with nothing concealed whose drive has a random force."""
    return compose("dc_motor", "0", np.random.default_rng(11), 6.0, Kind.FORCE)


@pytest.fixture(scope="module")
def answer(shaken: Composed) -> Answer:
    """Its answer."""
    return answer_of(shaken, "001", {})


def test_a_random_force_lasts_as_long_as_it_says() -> None:
    one = Disturbance(Kind.FORCE, 2.0, 0.1, 0.0)
    factor, added = one.sample(200_000, 1e-3, 3)
    assert np.all(factor == 1.0)
    assert np.std(added) == pytest.approx(2.0, rel=0.05)
    lag = round(0.1 / 1e-3)
    assert np.mean(added[lag:] * added[:-lag]) / np.var(added) == pytest.approx(np.exp(-1.0), abs=0.05)


def test_a_gain_that_drifts_goes_through_one_swing() -> None:
    factor, added = Disturbance(Kind.DRIFT, 0.1, 0.1, 0.0).sample(1000, 0.01, 3)
    assert not added.any()
    assert (factor.max(), factor.min()) == (pytest.approx(1.1, abs=1e-4), pytest.approx(0.9, abs=1e-4))
    assert np.sum(np.diff(np.sign(factor[1:-1] - 1.0)) != 0) == 1


def test_what_disturbs_is_as_strong_as_it_was_drawn(answer: Answer) -> None:
    low, high = (np.hypot(1.0, size) for size in SIZES)
    assert 0.85 * low < answer.baseline_strength < 1.15 * high
    told = answer.conditions["disturbance"]
    assert told["kind"] == "force"
    assert LASTS[0] <= told["lasts"] <= LASTS[1]


def test_the_recorded_command_is_the_one_that_was_sent(shaken: Composed) -> None:
    calm = replace(shaken.secret, disturbance=None)
    quiet = calm.setup.walk(calm, shaken.noise, 0)
    loop = shaken.secret.setup
    command, output = (signal.name for signal in loop.signals[:2])
    again = loop.walk(shaken.secret, shaken.noise, 0)
    assert not np.allclose(again.signals[output], quiet.signals[output])
    silent = loop.silent(shaken.secret, again, 0)
    assert np.array_equal(silent.signals[command], again.signals[command])
    # without noise it is the same motion, disturbed alike
    left = again.signals[output] - silent.signals[output]
    assert np.std(left) == pytest.approx(shaken.noise.sigma[0], rel=0.1)


def test_a_mismatch_without_a_name_is_no_false_alarm_where_something_disturbs(answer: Answer) -> None:
    def never(*_: object) -> float:
        raise AssertionError

    alarms = {
        verdict: judge(answer, StatedAnswer(verdict), never).alarm
        for verdict in ("no_mismatch", "unexplained_mismatch", "missing_physics")
    }
    assert alarms == {"no_mismatch": False, "unexplained_mismatch": False, "missing_physics": True}
    calm = replace(answer, conditions={})
    assert judge(calm, StatedAnswer("unexplained_mismatch"), never).alarm


@pytest.mark.parametrize(("rig", "word"), [("dc_motor", "wind"), ("ur5", "force")])
def test_what_cannot_disturb_is_refused(tmp_path: Path, rig: str, word: str) -> None:
    order = Order(rig, 1, "0", tmp_path / "set", answers_beside(tmp_path / "set"), 1, disturbed=word)
    with pytest.raises(UsageError, match="--disturbed: expected"):
        make_trials(order, 1, lambda text: None)
