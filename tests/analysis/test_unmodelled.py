"""Nonparametric forces of effects outside the catalogue: coordinate, curve and evidence."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.diagnose.discrepancy import absent_effects
from labhil.diagnose.exclusions import exclusions
from labhil.diagnose.force_curve import ForceCurve, state_curve
from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit
from labhil.diagnose.search_result import FittedCurve
from labhil.diagnose.structures.curves import CurveSearch
from labhil.diagnose.structures.disturbance import estimate_spectral_noise
from labhil.identify.fitted import Fitted, fit_by_continuation, start_theta
from labhil.identify.saved_curve import ModelUnderCurves
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, ExtraForce
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.plants.axis import AxisPlant
from labhil.rig import parse_rig
from labhil.signals import FloatArray, Hold
from labhil_benchmarks.statistics.cases import (
    BALL_BEAM_RIG,
    BALL_BEAM_TRUTH,
    CASES,
    held_ball,
)
from labhil_benchmarks.statistics.trial import Case

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay, staircase

pytestmark = pytest.mark.timeout(600)

AXIS_TERMS = ("viscous_friction", "coulomb_friction", "constant_force")
AXIS_RIG = '[rig]\nkind = "axis"\n[metric]\nhorizon = 1.4\n'
BALL_TERMS = ("viscous_friction", "coulomb_friction")
PERIOD = 0.005
ENCODER = 2e-5

Law = Callable[[FloatArray], FloatArray]


def held_axis(terms: tuple[str, ...], parameters: Mapping[str, float], seed: int, n: int) -> Record:
    """Sines on an axis that a weak spring in the controller keeps near zero."""
    random = np.random.default_rng([seed, n])
    t = PERIOD * np.arange(n)
    tones = zip((0.07, 0.31, 0.53, 1.3), (14.0, 25.0, 40.0, 15.0), random.uniform(0.0, 6.28, 4), strict=True)
    wanted = sum((size * np.cos(2.0 * np.pi * f * t + phase) for f, size, phase in tones), np.zeros(n))
    plant = AxisPlant({**parameters, "position_noise": 0.0}, (*AXIS_TERMS, *terms), 0, PERIOD)
    u, y = np.zeros(n), np.zeros(n)
    for i in range(n - 1):
        u[i] = wanted[i] - 250.0 * y[i]
        y[i + 1] = plant.step(u[i])["position"]
    seen = y + random.normal(0.0, ENCODER, n)
    return Record(t, u[:, None], seen[:, None], ("drive_force",), ("position",), ("m",), (Hold.ZERO,))


def held_balls(terms: tuple[str, ...], parameters: Mapping[str, float]) -> tuple[Record, Record]:
    """Two records of a ball on its beam, to search and to test on."""
    random = np.random.default_rng(3)
    truth = {k: v for k, v in BALL_BEAM_TRUTH.items() if k.partition(".")[0] in BALL_TERMS}
    first, second = (
        held_ball((*BALL_TERMS, *terms), {**truth, **parameters}, random.normal(0.0, 4e-4, n), phase)
        for n, phase in ((4000, 1.0), (6000, 2.5))
    )
    return first, second


def fitted(rig: str, terms: tuple[str, ...], record: Record, test: Record) -> tuple[Data, Fitted]:
    """Data of a search and the fitted baseline."""
    model = model_for(parse_rig(rig, Path("rig.toml")), record)
    begin = start_theta(model)
    window = 0.375 * model.horizon
    data = Data(model, record, test, noise_of(record), noise_of(test), window, begin)
    lengths = [0.5 * window, window, 2.0 * window]
    return data, fit_by_continuation(
        model, record, list(terms), lengths, data.sigma, start=begin, new_terms=terms
    )[-1]


def curve_of(data: Data, final: Fitted, baseline: tuple[str, ...]) -> FittedCurve | None:
    """The likeliest force curve beside or instead of the terms of a fit."""
    noise = estimate_spectral_noise(final.problem, final.solution.residuals)
    return CurveSearch(data, baseline, noise.correlation).run(final)


def unmodelled(data: Data, final: Fitted) -> ForceCurve | None:
    """The same as an answer states it, of a fit that names nothing."""
    found = curve_of(data, final, final.terms)
    return None if found is None else state_curve(data, found)


def largest_hidden(fit: Fitted, term: str) -> float | None:
    """The largest size of a term that the data could hide beside a fit; None where any could."""
    limits, _ = exclusions(absent_effects(fit), ())
    return next((limit.largest_hidden for limit in limits if limit.term == term), None)


def within(found: ForceCurve, law: Law) -> float:
    """Share of the visited range where the plant's own law lies within the band.

    But for a constant, which no record tells from the model's own dry friction or constant force.
    """
    truth = law(found.x)
    truth = truth + np.mean(found.value - truth)
    return float(np.mean((truth >= found.low) & (truth <= found.high)))


@pytest.mark.extended
def test_a_sticky_patch_is_found_where_it_is() -> None:
    """It is dry friction over the position; the rest of the record is at the noise."""
    parameters = {
        "constant_force.force": -0.5,
        "hidden_sticky_patch.level": 0.3,
        "hidden_sticky_patch.place": 0.0,
    }
    records = [held_axis(("hidden_sticky_patch",), parameters, seed, 4000) for seed in (1, 2)]
    data, final = fitted(AXIS_RIG, AXIS_TERMS, *records)
    found = unmodelled(data, final)
    assert found is not None
    assert (found.depends_on, found.acts) == (("position", "axis_velocity"), CurveArgument.POSITION_AGAINST)
    assert within(found, lambda x: 0.3 * np.exp(-0.5 * (x / 0.02) ** 2)) >= 0.9
    assert found.after.rmse <= 1.3 * found.after.noise_floor
    assert found.share >= 0.8
    assert found.fit.problem.model is found.model


@pytest.mark.extended
def test_a_magnet_under_the_beam_is_found_where_it_is() -> None:
    """It is a force over the ball's position; most of the error goes."""
    data, final = fitted(
        BALL_BEAM_RIG, BALL_TERMS, *held_balls(("hidden_magnet",), {"hidden_magnet.pull": 0.005})
    )
    found = unmodelled(data, final)
    assert found is not None
    assert (found.depends_on, found.acts, found.unit) == (("ball_position",), CurveArgument.POSITION, "N")

    def law(x: FloatArray) -> FloatArray:
        away = (x - 0.05) / 0.02
        return np.asarray(-0.005 * away * np.exp(0.5 - 0.5 * away**2))

    assert within(found, law) >= 0.9
    assert found.share >= 0.9
    # a curve over the position may be a spring in part, and excludes none as the terms alone seem to
    beside, alone = (largest_hidden(fit, "spring_hardening") for fit in (found.fit, final))
    assert beside is None or (alone is not None and beside > 5.0 * alone)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("hidden", "named", "stays"),
    [
        ({"hidden_magnet.pull": 0.002}, ("spring_force", "spring_hardening"), False),
        ({"hidden_magnet.pull": 0.002}, ("constant_force",), False),
        ({"hidden_magnet.pull": 0.0008}, (), False),
        ({"spring_force.stiffness": 0.1}, ("spring_force",), True),
        ({}, (), True),
    ],
)
def test_a_curve_replaces_only_terms_that_imitate_it(
    hidden: Mapping[str, float], named: tuple[str, ...], stays: bool
) -> None:
    """A magnet is no sum of springs; a curve is no likelier than a spring that is there."""
    effects = tuple({key.partition(".")[0] for key in hidden})
    data, base = fitted(BALL_BEAM_RIG, BALL_TERMS, *held_balls(effects, hidden))
    final = refit(replace(data, window=2.0 * data.window), base, (*base.terms, *named), named, thorough=True)
    found = curve_of(data, final, base.terms)
    if stays:
        assert found is None
    else:
        assert found is not None
        assert not set(named) & set(found.beside.terms)
        assert found.curve_fit.model.coordinate.name == "ball_position"


@pytest.mark.extended
@pytest.mark.parametrize("rig", ["axis", "ball_beam"])
def test_a_complete_model_has_no_curve(rig: str) -> None:
    """A complete model leaves only noise."""
    if rig == "axis":
        records = [held_axis((), {"constant_force.force": -0.5}, seed, 3000) for seed in (3, 4)]
        data, final = fitted(AXIS_RIG, AXIS_TERMS, *records)
    else:
        data, final = fitted(BALL_BEAM_RIG, BALL_TERMS, *held_balls((), {}))
    assert unmodelled(data, final) is None


# every rig has a kernel with one more force, and compiling one takes half a minute
@pytest.mark.extended
@pytest.mark.parametrize("kind", ["ball_beam", "axis", "dc_motor", "solenoid"])
@pytest.mark.parametrize("acts", [CurveArgument.TIME, CurveArgument.POSITION])
def test_no_force_changes_nothing(kind: str, acts: CurveArgument) -> None:
    """A force that is zero everywhere gives the same numbers, bit by bit."""
    case: Case = CASES[kind]
    record = case.simulate(1, False).record
    model = model_for(parse_rig(case.rig, Path("rig.toml")), record)
    assert isinstance(model, AcceptsExtraForce)
    theta = start_theta(model, case.truth)
    windows = fit_windows(record, 0.4 * model.horizon)
    states = model.initial_states(record, windows)
    grid = np.linspace(-10.0, 10.0, 5)
    nothing = ExtraForce(acts, grid, np.zeros(5), np.inf, course=np.zeros(len(record)))
    plain = model.simulate(theta, record, windows, states)
    assert np.array_equal(plain, model.with_force(nothing).simulate(theta, record, windows, states))


@pytest.mark.extended
def test_a_magnet_beside_a_shaft_is_found_although_no_channel_measures_the_angle() -> None:
    """The measured speed says how far it turned; where the test began is found by what it shows."""
    hidden = {"hidden_magnet.pull": 0.15, "hidden_magnet.width": 0.4}
    noise = {"speed_noise": 0.03, "current_noise": 0.03}
    runs = (
        replay(
            "dc_motor", staircase(40.0, 0.01, 0.5, 5.0, seed), ("viscous_friction", "hidden_magnet"), hidden,
            noise=noise, seed=seed,
        ).record
        for seed in (1, 2)
    )  # fmt: skip
    search, test = (replace(record, auxiliary={}) for record in runs)
    test = test.part(730, len(test))
    data, final = fitted('[rig]\nkind = "dc_motor"\n', ("viscous_friction",), search, test)
    found = unmodelled(data, final)
    assert found is not None
    assert (found.depends_on, found.acts) == (("shaft_angle",), CurveArgument.POSITION)
    assert found.share >= 0.85  # rounding decides between minima of 0.885 and 0.939
    kept = ModelUnderCurves(data.model, [found.kept])
    assert kept.state_names == ("shaft_velocity", "current", "shaft_angle")
    own = found.model.split(found.fit.theta)[0]
    # from the same states: of two angles that a lead-in tells apart by a nat, rounding may choose either
    windows, states = found.after.windows.whole, found.after.states
    again = kept.simulate(own, test, windows, states)
    before = found.model.simulate(found.fit.theta, test, windows, states)
    assert (np.std(again - before, axis=0) < 0.05 * np.std(found.after.errors, axis=0)).all()
