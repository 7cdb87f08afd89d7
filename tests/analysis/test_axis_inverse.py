"""An axis by inverse dynamics: forces that balance on a plant whose numbers are known, and a fit by them."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.analysis.results import fit_json
from labhil.analysis.schema import FitPart, validate
from labhil.errors import RecordingError, UsageError
from labhil.identify.fit import Options, fit
from labhil.identify.score import score, with_forces
from labhil.physics.model import Metric, index_of
from labhil.physics.record import Record
from labhil.physics.rigs import by_inverse_dynamics, model_for
from labhil.report.html.fit import fit_page
from labhil.report.html.picture import Album
from labhil.rig import default_rig

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import Replay, replay, rig_of

PERIOD = 1e-3
TERMS = ("viscous_friction", "coulomb_friction", "friction_asymmetry", "load_dependent_friction")
INVERSE = Options(criterion=Metric.INVERSE_DYNAMICS)


def pushes() -> np.ndarray:
    """Forces (N) of a few slow tones, that move the axis both ways at several speeds."""
    t = PERIOD * np.arange(8000)
    return 60.0 * np.sin(2 * np.pi * 0.5 * t) + 40.0 * np.sin(2 * np.pi * 1.3 * t + 1.0)


@pytest.fixture(scope="module")
def found() -> Replay:
    return replay("axis", pushes(), TERMS, period=PERIOD, noise={"position_noise": 1e-6})


def test_the_force_that_the_true_model_needs_is_the_drives(found):
    forces = found.model.balance(found.theta, found.record)
    size = np.sqrt(np.mean(forces.exerted**2))
    left = np.sqrt(np.mean((forces.needed - forces.exerted) ** 2))
    assert 30.0 < size < 80.0
    assert left < 0.02 * size
    assert forces.cut_off == 20.0


def test_forces_stand_beside_the_score_and_enter_no_headline(found):
    sigma = np.array([1e-6])
    alone = score(found.model, found.theta, found.record, sigma)
    both = with_forces(alone, found.model, found.theta, found.record, sigma)
    (forces,) = both.beside
    assert (forces.channel, forces.unit, forces.metric) == ("drive_force", "N", Metric.INVERSE_DYNAMICS)
    assert forces.relative_error == pytest.approx(np.sqrt(1.0 - forces.r2), rel=0.05)
    assert 0.0 < forces.noise_floor < forces.rmse < 1.5
    assert (both.rmse, both.mse, both.r2) == (alone.rmse, alone.mse, alone.r2)
    assert both.noise_floor == alone.noise_floor
    assert both.max_abs_error == alone.max_abs_error
    assert [row.metric for row in both.reported] == ["windowed_simulation", "inverse_dynamics"]


def test_a_fit_by_inverse_dynamics_finds_the_numbers_and_is_scored_by_simulation(found):
    result = fit(found.model, found.record, TERMS, options=INVERSE)
    assert result.criterion is Metric.INVERSE_DYNAMICS
    assert result.train.metric is Metric.WINDOWED_SIMULATION
    assert result.train.r2 > 0.99
    (error,) = result.channel_errors
    assert (error.channel, error.unit) == ("drive_force", "N")
    assert error.rmse == pytest.approx(result.train.beside[0].rmse, rel=0.1)
    places = index_of(found.model.parameters)
    for row in result.estimates:
        truth = found.theta[places[row.name]]
        assert row.value == pytest.approx(truth, rel=0.03, abs=4.0 * row.std_error), row.name


def test_a_page_names_the_metric_of_the_forces_and_keeps_the_headline_in_metres(found):
    result = fit(found.model, found.record, ("viscous_friction", "coulomb_friction"), options=INVERSE)
    fit_part = validate(FitPart, fit_json(result, [], "axis", "hybrid", 0, 0.0), "the fit")
    assert fit_part.train.unit == "m"
    page = str(fit_page(fit_part, "", Album()))
    assert "inverse dynamics" in page
    assert "of the RMS" in page


def test_a_voltage_is_fitted_in_volts_by_its_known_gain(found):
    """35 N/V: the same axis, the same numbers."""
    volts = replace(found.record, inputs=found.record.inputs / 35.0, input_names=("drive_voltage",))
    model = model_for(rig_of("axis", "drive_gain = 35.0\n"), volts)
    result = fit(model, volts, TERMS, options=INVERSE)
    by_force = fit(found.model, found.record, TERMS, options=INVERSE)
    assert (result.channel_errors[0].channel, result.channel_errors[0].unit) == ("drive_voltage", "V")
    for row, other in zip(result.estimates, by_force.estimates, strict=True):
        assert row.value == pytest.approx(other.value, rel=1e-3), row.name


def test_rest_is_not_judged_and_an_axis_that_never_moves_is_refused(found):
    n = len(found.record)
    rest = np.full((n, 1), found.record.outputs[0, 0])
    halves = replace(
        found.record,
        t=PERIOD * np.arange(2 * n),
        inputs=np.vstack([found.record.inputs, 5.0 + 0.0 * found.record.inputs]),
        outputs=np.vstack([found.record.outputs, found.record.outputs[-1] + 0.0 * rest]),
        auxiliary={},
    )
    moving = by_inverse_dynamics(found.model).prepare(halves)
    assert moving.t[-1] < PERIOD * (n + 200)
    with pytest.raises(RecordingError, match="too little motion"):
        by_inverse_dynamics(found.model).prepare(replace(found.record, outputs=rest))
    still = with_forces(
        score(found.model, found.theta, found.record, np.array([1e-6])),
        found.model, found.theta, replace(found.record, outputs=rest), np.array([1e-6]),
    )  # fmt: skip
    assert still.beside == ()


def test_what_does_not_push_on_the_mass_is_not_offered(found):
    inverse = by_inverse_dynamics(found.model)
    assert {"viscous_friction", "spring_force", "cogging_torque"} <= set(inverse.terms)
    for key in ("dead_zone", "time_delay", "sensor_gain", "static_friction"):
        assert key not in inverse.terms
        assert inverse.unobservable_terms[key]
    with pytest.raises(UsageError, match="axis and ur5"):
        by_inverse_dynamics(model_for(default_rig("ball_beam")))


def test_a_cut_off_of_the_rig_file_is_kept_within_what_the_samples_allow(found):
    slow = found.record.part(0, len(found.record))
    thin = Record(
        slow.t[::20], slow.inputs[::20], slow.outputs[::20], slow.input_names, slow.output_names,
        slow.output_units, slow.input_holds,
    )  # fmt: skip
    assert found.model.balance(found.theta, thin).cut_off == pytest.approx(5.0)
