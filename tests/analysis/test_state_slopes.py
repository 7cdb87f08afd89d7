"""Slopes by the states that windows begin with, beside the jump of a part that breaks away or does not."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.identify.problem import Point, Problem
from labhil.physics.model import index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import model_for
from labhil.rig import default_rig

FORCE, HELD = 10.0, 8.0
"""N: the drive's push, and the friction of a moving axis."""


def pushed(static: float) -> tuple[Problem, Point]:
    """An axis that is pushed harder than moving friction takes, on two windows that begin at rest."""
    t = 1e-3 * np.arange(400)
    record = Record(
        t, np.full((400, 1), FORCE), np.zeros((400, 1)), ("drive_force",), ("position",), ("m",)
    )  # fmt: skip
    model = model_for(default_rig("axis"), record)
    theta, places = start_values(model.parameters), index_of(model.parameters)
    values = {"moving_mass": 10.0, "coulomb_friction.level": HELD, "static_friction.level": static}
    for key, value in values.items():
        theta[places[key]] = value
    windows = Windows.of([(0, 200), (200, 400)])
    problem = Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, np.array([1e-5]))
    return problem, Point(np.empty(0), np.zeros((2, 2)))


def test_slopes_do_not_cross_to_where_a_part_breaks_away():
    problem, point = pushed(static=5.0)
    residuals = problem.residuals(point)
    np.testing.assert_array_equal(residuals, 0.0)
    velocity = problem.model.state_names.index("axis_velocity")
    lin = problem.linearise(point, residuals)
    ahead = lin.by_states[:, velocity]
    flatter = problem.flatter_state_slopes(point, lin)[:, velocity]
    # a shove forward starts it for good, as little as it may be; one back ends where it began
    assert np.abs(ahead).max() > 1e3 * np.abs(flatter).max()


def test_slopes_of_a_moving_part_are_the_same_to_both_sides():
    problem, point = pushed(static=0.0)
    moving = Point(point.z, point.states + np.array([0.0, 0.1]))
    residuals = problem.residuals(moving)
    lin = problem.linearise(moving, residuals)
    assert problem.flatter_state_slopes(moving, lin) == pytest.approx(lin.by_states, rel=1e-3, abs=1e-3)
