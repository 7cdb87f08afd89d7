"""The current loop against its closed form, and plants that are walked in pieces."""

import numpy as np
import pytest

from labhil.errors import UsageError
from labhil.plants.current_loop import CurrentLoop
from labhil.plants.dc_motor import DcMotorPlant
from labhil.plants.solenoid import SolenoidPlant


def test_the_current_follows_with_the_lag_of_the_loop():
    loop = CurrentLoop(inductance=0.02, lag=0.005, supply=1e3, rate=1e5, period=1e-3)
    seen = loop.follow(np.full(20, 1.5), resistance=4.0)
    np.testing.assert_allclose(seen, 1.5 * (1.0 - np.exp(-np.arange(1, 21) * 1e-3 / 0.005)), atol=3e-3)


def test_the_supply_limits_the_slope_and_the_integral_does_not_wind_up():
    loop = CurrentLoop(inductance=0.02, lag=0.001, supply=12.0, rate=1e5, period=1e-3)
    seen = loop.follow(np.full(60, 2.5), resistance=4.0)
    free = 3.0 * (1.0 - np.exp(-np.arange(1, 4) * 1e-3 * 4.0 / 0.02))
    np.testing.assert_allclose(seen[:3], free, rtol=1e-6)
    assert seen.max() < 2.5 * 1.005
    assert seen[-1] == pytest.approx(2.5, rel=1e-3)


def test_a_loop_too_slow_for_its_lag_is_refused():
    with pytest.raises(UsageError, match="loop_time"):
        CurrentLoop(inductance=0.02, lag=1e-3, supply=12.0, rate=1e3, period=1e-3)


@pytest.mark.parametrize(
    ("plant", "size", "signal"),
    [(SolenoidPlant, 1.2, "coil_voltage"), (DcMotorPlant, 5.0, "speed")],
)
def test_a_plant_walked_in_pieces_is_the_plant_walked_at_once(plant, size, signal):
    u = size * np.abs(np.sin(0.05 * np.arange(300)))
    whole = plant(terms=["viscous_friction", "coulomb_friction"], seed=3).advance(u)
    other = plant(terms=["viscous_friction", "coulomb_friction"], seed=3)
    parts = [other.advance(part)[signal] for part in np.split(u, [1, 2, 50, 57, 200])]
    np.testing.assert_allclose(np.concatenate(parts), whole[signal], atol=1e-9)
