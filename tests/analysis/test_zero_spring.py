"""A magnet that levitates has no spring: fitted and diagnosed with [known] spring_stiffness = 0."""

from pathlib import Path

import numpy as np
import pytest

from labhil.diagnose.diagnosis import diagnose
from labhil.identify.fit import Options, fit
from labhil.identify.intervals import Intervals
from labhil.physics.rigs import model_for
from labhil.rig import parse_rig
from labhil_benchmarks.statistics.cases import driven

RIG = """
[rig]
kind = "solenoid"
[known]
moving_mass = 0.064
spring_stiffness = 0.0
stop_low = 0.0
stop_high = 0.005
"""
TRUTH = {
    "spring_stiffness": 0.0,
    "viscous_friction.coefficient": 150.0,
    "constant_force.force": -12.0,
    "coulomb_friction.level": 2.0,
}
TERMS = ("viscous_friction", "constant_force", "coulomb_friction")


def levitated(samples, random):
    t = 1e-3 * np.arange(samples)
    a, b = random.uniform(0.0, 2.0 * np.pi, 2)
    current = 0.78 + 0.14 * np.sin(6.0 * np.pi * t + a) + 0.1 * np.sin(14.6 * np.pi * t + b)
    channels = (("plunger_position", "m"),)
    return driven("solenoid", current, 1e-3, TRUTH, TERMS, 40.0, False, random, channels)[0]


@pytest.fixture(scope="module")
def records():
    random = np.random.default_rng(3)
    return levitated(1500, random), levitated(1000, random)


@pytest.mark.extended
@pytest.mark.filterwarnings("error")
def test_a_magnet_without_a_spring_is_fitted(records):
    model = model_for(parse_rig(RIG, Path("rig.toml")), records[0])
    learn, judge = (model.prepare(record) for record in records)
    found = fit(model, learn, TERMS, test=judge, options=Options(window=0.1, intervals=Intervals.WALD))
    for row in found.estimates:
        assert row.value == pytest.approx(TRUTH[row.key], rel=0.05)
    assert 0.02 <= found.test.horizon <= 0.5
    assert found.test.r2 > 0.99


@pytest.mark.extended
@pytest.mark.timeout(600)
def test_what_a_magnet_without_a_spring_lacks_is_found(records):
    searched, test = records
    model = model_for(parse_rig(RIG, Path("rig.toml")), searched)
    baseline = ("viscous_friction", "constant_force")
    found = diagnose(model, searched, test, heldout_is_test=True, baseline=baseline, measured=searched)
    assert [missing.term for missing in found.missing] == ["coulomb_friction"]
