"""How far ahead a model predicts, against systems whose growth of errors is known."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.identify.predictability import predictability_horizon
from labhil.physics.model import Model, start_values
from labhil.physics.record import Record
from labhil.physics.right_hand_side import RightHandSide
from labhil.physics.terms import Parameter
from labhil.rig import default_rig
from labhil.signals import Hold

SIGMA = np.array([0.01])
PERIOD = 0.01


def exponential(rate: float) -> tuple[Model, Record]:
    """ẋ = rate·x + u, beside a measured sine of unit amplitude."""
    t = PERIOD * np.arange(4000)
    stated = RightHandSide(
        states={"level": 1.0},
        derivative=lambda t, x, u, p: np.array([p["rate"] * x[0] + u[0]]),
        output=lambda x, u, p: x,
        guess=lambda t, y: y[0],
        parameters=(Parameter("rate", "1/s", 1.0, -10.0, 10.0, starts=(rate,)),),
        horizon=1.0,
    )
    names = (("u",), ("level",), ("m",), (Hold.ZERO,))
    record = Record(t, np.zeros((len(t), 1)), np.sin(3.0 * t)[:, None], *names)
    return stated(default_rig("dc_motor")), record


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_an_unstable_system_is_predictable_until_its_errors_are_as_large_as_its_signal(rate):
    model, record = exponential(rate)
    horizon = predictability_horizon(model, start_values(model.parameters), record, SIGMA, 20.0)
    early = np.exp(rate * PERIOD * np.arange(38))  # the first 0.375 s, to which growth is relative
    ratio = np.std(record.outputs) / SIGMA[0] * np.sqrt(np.mean(early**2))
    assert horizon == pytest.approx(np.log(ratio) / rate, abs=2 * PERIOD)


@pytest.mark.parametrize("rate", [-1.0, 0.0, 0.1])
def test_windows_of_a_system_that_forgets_or_grows_slowly_are_not_limited(rate):
    model, record = exponential(rate)
    assert predictability_horizon(model, start_values(model.parameters), record, SIGMA, 20.0) == 20.0
