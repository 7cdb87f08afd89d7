"""The gate between fits that explain their data and fits that do not, and what a fit then shows."""

from __future__ import annotations

import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import Replay, replay, staircase

from labhil.analysis.results import fit_json
from labhil.analysis.schema import FitPart, validate
from labhil.analysis.verdicts import fit_verdict
from labhil.diagnose.intake import FaultKind, assess_usability, detect_faults
from labhil.identify.adequacy import MAX_EXPLAINED_RATIO, FitVerdict, adequacy_of
from labhil.identify.fit import Fit, Options, fit
from labhil.report.text import fit_text

TERMS = ["viscous_friction", "coulomb_friction"]
FAST = Options(estimator="nlse")


@pytest.fixture(scope="module")
def motor() -> Replay:
    u = staircase(10.0, 0.01, 0.6, 6.0, 1)
    return replay("dc_motor", u, TERMS, noise={"speed_noise": 0.02, "current_noise": 0.02}, seed=1)


def shown(found: Fit) -> str:
    text = StringIO()
    data = fit_json(found, [], "dc_motor", "nlse", 0, 0.0)
    Console(width=140, file=text).print(fit_text(validate(FitPart, data, "the fit")))
    return text.getvalue()


def with_speed(found: Replay, change) -> Replay:
    outputs = found.record.outputs.copy()
    outputs[:, 0] = change(outputs[:, 0])
    return replace(found, record=replace(found.record, outputs=outputs))


def test_a_complete_model_explains_and_its_parameters_are_starred(motor):
    found = fit(motor.model, motor.record, TERMS, options=FAST)
    assert found.adequacy.verdict is FitVerdict.EXPLAINED
    assert set(found.adequacy.residual_over_noise) == {"speed", "current"}
    assert all(ratio < MAX_EXPLAINED_RATIO for ratio in found.adequacy.residual_over_noise.values())
    text = shown(found)
    assert text.startswith("Explained to the noise: residual of ")
    assert " * " in text


def test_a_speed_that_counts_backwards_is_worse_than_its_mean_or_unexplained_and_nothing_is_starred(motor):
    turned = with_speed(motor, np.negative)
    found = fit(turned.model, turned.record, TERMS, options=FAST)
    assert found.adequacy.verdict is not FitVerdict.EXPLAINED
    assert found.adequacy.worst == "speed"
    text = shown(found)
    assert text.splitlines()[0].split(":")[0] in ("Worse than its own mean", "Not explained")
    assert " * " not in text
    assert "labhil diagnose" in text


@pytest.mark.extended
def test_an_incomplete_model_has_intervals_that_hold_how_far_its_estimates_move(motor):
    spikes = np.random.default_rng(0).choice(1000, 10, replace=False)
    hit = with_speed(motor, lambda speed: speed + 40.0 * np.isin(np.arange(len(speed)), spikes))
    found = fit(hit.model, hit.record, TERMS, options=FAST)
    assert found.adequacy.verdict is not FitVerdict.EXPLAINED
    assert found.compared
    for row in found.estimates:
        for rung in found.by_window:
            if rung.window in found.compared and np.isfinite(rung.std_errors[row.key]):
                excess = (rung.values[row.key] - row.value) ** 2 - rung.std_errors[row.key] ** 2
                assert row.std_error**2 >= 0.999 * excess / len(found.compared)
    errors = np.array([row.std_error for row in found.estimates])
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(errors)


@pytest.mark.extended
def test_a_chopped_current_is_named(motor):
    outputs = motor.record.outputs.copy()
    outputs[:, 1] = np.abs(outputs[:, 1]) * (1.0 - (-1.0) ** np.arange(len(outputs)))
    chopped = replace(motor.record, outputs=outputs)
    faults = detect_faults(chopped)
    assert [(fault.kind, fault.channel) for fault in faults] == [(FaultKind.UNDERSAMPLED, "current")]
    assert "chopper" in faults[0].statement and not assess_usability(chopped, faults).is_usable
    found = fit(motor.model, chopped, TERMS, options=FAST)
    assert any("current" in note and "chopper" in note for note in found.sampling)
    assert " * " not in shown(found)


def test_each_channel_counts_where_it_is_worst(motor):
    good = fit(motor.model, motor.record, TERMS, options=FAST).train
    (speed, current) = good.channels
    for r2, verdict in ((0.5, FitVerdict.UNEXPLAINED), (-0.2, FitVerdict.WORSE_THAN_MEAN)):
        bad = replace(good, channels=(speed, replace(current, rmse=5.0 * current.noise_floor, r2=r2)))
        judged = adequacy_of([good, bad])
        assert (judged.verdict, judged.worst) == (verdict, "current")
        assert judged.residual_over_noise["current"] == pytest.approx(5.0)
    # at the noise a channel is explained, whatever its R²: one that hardly moves has none to speak of
    still = replace(good, channels=(speed, replace(current, r2=-0.01)))
    assert adequacy_of([still]).explained


def test_the_line_of_a_verdict():
    assert fit_verdict("explained", {"position": 0.971}, 1.0) == (
        "Explained to the noise: residual 0.97 times the noise."
    )
    assert fit_verdict("worse_than_mean", {"speed": 212.4, "current": 1.0}, -0.2) == (
        "Worse than its own mean: residual of speed 212 times the noise (R² -20 %)."
    )
    assert fit_verdict("unexplained", {"position": None}, None) == (
        "Not explained: residual inf times the noise."
    )
