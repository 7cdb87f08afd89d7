"""Held-out data under fits whose parameters are not known exactly; windows whose states hide in valleys."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.diagnose.diagnosis import data_of
from labhil.diagnose.evidence import unlikelier
from labhil.diagnose.foretold import foretold
from labhil.diagnose.judge import Data
from labhil.identify.fitted import Fitted, covariances, fit_terms
from labhil.identify.problem import Problem
from labhil.identify.window_states import States, looked_anew, settled_states, tried
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Record, index_of, joined, start_values
from labhil.plants.ball_beam import BallBeamPlant

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import Replay, replay, staircase

SIGMA = np.array([0.03, 0.05])
TERMS = ("viscous_friction",)
NOT_THERE = ("coulomb_friction", "quadratic_viscous_friction")


def motor(seconds: float, seed: int) -> Replay:
    u = staircase(seconds, 0.01, 0.5, 8.0, seed)
    return replay("dc_motor", u, TERMS, noise={"speed_noise": 0.03, "current_noise": 0.05}, seed=seed)


def data_with(searched: Replay, held_out: Replay) -> Data:
    data = data_of(searched.model, searched.record, held_out.record)
    return replace(data, sigma=SIGMA, test_sigma=SIGMA)


def fitted(data: Data, record: Record, terms: Sequence[str] = TERMS) -> Fitted:
    return fit_terms(data.model, record, terms, data.window, SIGMA)


def test_it_is_what_a_fit_of_all_data_says_beyond_a_fit_of_the_searched_ones():
    """Costs of a joint fit over one of the searched data, with the volumes that their parameters fill."""
    data = data_with(motor(6.0, 1), motor(20.0, 2))
    found = fitted(data, data.search)
    both = fitted(data, joined([data.search, data.test]))
    said, plain = foretold(data, found), data.left(data.model, found.theta)
    volumes = [np.linalg.slogdet(covariances(fit)[1])[1] for fit in (found, both)]
    expected = both.solution.cost - found.solution.cost + volumes[0] - volumes[1]
    assert np.sum(said.residuals**2) + said.price == pytest.approx(expected, abs=1.0)
    assert np.sum(said.residuals**2) < np.sum(plain.residuals**2) - 10.0


def test_terms_that_are_not_there_cost_what_their_freedom_is_worth_however_badly_they_were_known():
    """Fitted to two seconds they foretell badly: held where they are they lose hundreds, by chance or not."""
    held, freed = [], []
    for seed in range(3, 8):
        data = data_with(motor(2.0, seed), motor(30.0, 40 + seed))
        small, large = fitted(data, data.search), fitted(data, data.search, (*TERMS, *NOT_THERE))
        held.append(unlikelier(data.left(data.model, small.theta), data.left(data.model, large.theta)))
        freed.append(unlikelier(foretold(data, small), foretold(data, large)))
    assert max(held) > 300.0
    assert min(freed) > 0.0
    assert max(freed) < 30.0


def sticking(model, acquire) -> Problem:
    """The true model of a ball that sticks and slips, on windows of 7.5 s."""
    terms = ("viscous_friction", "coulomb_friction", "stribeck_friction")
    parameters = {"coulomb_friction.level": 4e-4, "stribeck_friction.level": 1.6e-3}
    record = acquire(terms, 5, parameters=parameters, amplitude=0.25, duration=40.0)
    theta, places = start_values(model.parameters), index_of(model.parameters)
    for name, value in BallBeamPlant(parameters, terms, 5).parameters.items():
        if name in places and name.partition(".")[0] in terms:
            theta[places[name]] = value
    windows = fit_windows(record, 7.5)
    return Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, noise_of(record))


def worst_of(problem: Problem, found: States) -> float:
    """Mean square of the window that leaves most, in squares of noise."""
    return float(np.max(found.costs(problem) / np.bincount(problem.owner)))


def test_a_thorough_look_finds_the_states_of_windows_in_which_a_ball_sticks(model, acquire):
    problem = sticking(model, acquire)
    quick, thorough = (settled_states(problem, np.empty(0), thorough=each) for each in (False, True))
    assert worst_of(problem, thorough) < 1.44 < worst_of(problem, quick)


def test_windows_that_steps_of_the_parameters_led_astray_find_back(model, acquire):
    """All of them: none sticks out of the others."""
    problem, nothing = sticking(model, acquire), np.empty(0)
    astray = tried(problem, nothing, problem.guess + np.array([0.0, 0.5]))
    assert np.min(astray.costs(problem)) > 1e4
    assert worst_of(problem, looked_anew(problem, nothing, astray)) < 1.44
