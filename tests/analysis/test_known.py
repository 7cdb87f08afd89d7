"""What is known to a common factor only: the same wherever along the unknown direction a fit ended."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.identify.fitted import fit_terms
from labhil.identify.known import IdentifiableDirections
from labhil.identify.problem import Point, Problem
from labhil.physics.model import index_of

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay, staircase

TERMS = ("viscous_friction", "coulomb_friction")
SIGMA = np.array([0.02])


@pytest.fixture(scope="module")
def motor():
    """A motor of which the speed is known, and resistance and inductance, too small to show."""
    return replay(
        "dc_motor", staircase(20.0, 0.01, 0.4, 5.0, 1), TERMS, {"inductance": 1e-4},
        known="resistance = 1.5\ninductance = 1e-4\n", noise={"speed_noise": SIGMA[0]}, outputs=("speed",),
    )  # fmt: skip


def along_the_valley(motor, factor):
    """A fit with the torque constant held at so many times its value, then taken as if all had been free."""
    model, record, places = motor.model, motor.record, index_of(motor.model.parameters)
    begin = motor.theta.copy()
    for name in ("torque_constant", "inertia", "coulomb_friction.level"):
        begin[places[name]] *= factor
    held = fit_terms(model, record, TERMS, 4.0, SIGMA, start=begin, starts=[{}], held={"torque_constant"})
    every = np.union1d(held.problem.free, [places["torque_constant"]])
    problem = Problem(model, record, held.problem.windows, every, held.theta, SIGMA)
    point = Point(problem.start().z, held.solution.point.states)
    return replace(held, problem=problem, solution=replace(held.solution, point=point))


def ratio(fitted, above, below):
    """One value over another, and its standard error."""
    names = [fitted.problem.model.parameters[i].key for i in fitted.problem.free]
    values = fitted.theta[fitted.problem.free]
    i, j = names.index(above), names.index(below)
    slopes = np.zeros((1, len(values)))
    slopes[0, i], slopes[0, j] = 1.0 / values[j], -values[i] / values[j] ** 2
    known = IdentifiableDirections.of(fitted, fitted.covariances[2])
    return values[i] / values[j], float(np.sqrt(known.covariance(slopes)[0, 0]))


@pytest.mark.parametrize("factor", [1.0, 0.3, 0.01])
def test_a_ratio_is_known_where_neither_value_is(motor, factor):
    fitted = along_the_valley(motor, factor)
    places = index_of(motor.model.parameters)
    truth = motor.theta[places["coulomb_friction.level"]] / motor.theta[places["torque_constant"]]
    value, error = ratio(fitted, "coulomb_friction.level", "torque_constant")
    assert abs(value - truth) < 4.0 * error
    assert error < 0.02 * truth


def test_a_value_with_a_part_in_an_unknown_direction_is_not_known(motor):
    fitted = along_the_valley(motor, 1.0)
    known = IdentifiableDirections.of(fitted, fitted.covariances[2])
    assert len(known.unknown) == 1
    names = [fitted.problem.model.parameters[i].key for i in fitted.problem.free]
    alone = np.eye(len(names))[[names.index("torque_constant")]]
    assert np.isinf(known.covariance(alone)[0, 0])


def test_where_all_is_known_errors_are_those_of_the_fit(motor):
    fitted = along_the_valley(motor, 1.0)
    without = np.setdiff1d(fitted.problem.free, [index_of(motor.model.parameters)["torque_constant"]])
    old = fitted.problem
    problem = Problem(old.model, old.record, old.windows, without, fitted.theta, SIGMA)
    point = Point(problem.start().z, fitted.solution.point.states)
    held = replace(fitted, problem=problem, solution=replace(fitted.solution, point=point))
    robust, _, jacobian = held.covariances
    known = IdentifiableDirections.of(held, jacobian)
    assert not len(known.unknown)
    found = known.covariance(np.eye(len(without)))
    # either takes the largest of several errors, here along directions and there parameter by parameter
    assert np.sqrt(np.diag(found)) == pytest.approx(np.sqrt(np.diag(robust)), rel=0.3)
