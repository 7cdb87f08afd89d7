"""The reference text's motor, case two: what speed alone can know, and what the current adds."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.identify.fit import fit
from labhil.identify.further_channels import suggest_measurements
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.plants.dc_motor import DcMotorPlant
from labhil.rig import default_rig
from labhil.signals import Hold
from labhil_benchmarks.statistics.cases import CASES
from labhil_benchmarks.statistics.trial import run_trial

TERMS = ("viscous_friction", "coulomb_friction")
UNITS = {"speed": "rad/s", "current": "A"}
TRUTH = {"inertia": 0.1, "torque_constant": 0.2, "resistance": 1.5, "inductance": 0.1}


def record_of(*channels: str) -> Record:
    random = np.random.default_rng(3)
    voltage = np.repeat(random.uniform(-5.0, 5.0, 24), 50)
    measured = DcMotorPlant({}, TERMS, seed=1).simulate(voltage).measured
    outputs = np.column_stack([measured[name] for name in channels])
    units = tuple(UNITS[name] for name in channels)
    return Record(
        0.01 * np.arange(len(voltage)), voltage[:, None], outputs, ("voltage",), channels, units, (Hold.ZERO,)
    )


@pytest.mark.extended
def test_with_the_current_every_value_is_known():
    record = record_of("speed", "current")
    found = fit(model_for(default_rig("dc_motor"), record), record, TERMS)
    rows = {row.name: row for row in found.estimates}
    assert found.identifiability.rank == found.identifiability.of == 6
    for name, truth in TRUTH.items():
        assert rows[name].identifiable
        assert abs(rows[name].value - truth) < 4.5 * rows[name].std_error


@pytest.mark.extended
def test_from_speed_alone_a_scale_is_unknown_and_the_current_would_tell():
    record = record_of("speed")
    rig = default_rig("dc_motor")
    found = fit(model_for(rig, record), record, TERMS)
    judged = suggest_measurements(found.identifiability, rig, found.fitted)
    rows = {row.name: row for row in found.estimates}
    assert judged.rank < judged.of
    assert "current" in judged.would_help
    for name in ("inertia", "resistance", "coulomb_friction.level"):
        assert not rows[name].identifiable
        assert not rows[name].significant
    # two time constants may change places: an honest interval reaches over both
    low, high = rows["torque_constant"].ci99
    assert low < TRUTH["torque_constant"] < high
    product = rows["inertia"].value * rows["resistance"].value
    assert 1e-3 < product < 1.0
    assert any("inertia" in text for text in judged.combinations)


@pytest.mark.extended
def test_a_size_whose_interval_spans_orders_is_not_called_known():
    # coloured noise leads to a corner where curvature says each value is known to a half; profiles do not
    trial = run_trial(CASES["dc_motor_speed_only"], 40, coloured=True)
    for row in trial.rows:
        assert row.low <= row.truth <= row.high
        assert not row.identifiable
