"""Composition of one trial: draw a secret, scale its effects to their target strengths, compute the answer.

``make.py`` writes the recordings and seals the answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.bench import bench_of
from labhil.campaign.trials.disturbance import SIZE_RANGE, Disturbance, DisturbanceKind
from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.oracle import Oracle, Refit
from labhil.campaign.trials.secret import DrawnEffect, Secret, SimulatedRun
from labhil.campaign.trials.trial_types import BRISTLES, EFFECT_COUNTS
from labhil.campaign.trials.truth import model_values
from labhil.errors import RecordingError, RunError, UsageError
from labhil.physics.rigs import model_for, rig_model
from labhil.rig import parse_rig


@dataclass(frozen=True, slots=True)
class ScaleSearch:
    """Options of the search for the size at which an effect has its target strength.

    Attributes:
        tolerance: difference of the logarithms of strength and target that is close enough.
        max_refits: number of sizes that are tried.
        size_range: smallest and largest factor of an effect's drawn size.
        min_excess: excess of the squared RMSE, in squared noise floors, that counts as one.
        min_growth: exponent of the size with which an effect's excess grows at least; with less, the data do
            not show the effect, or the baseline absorbs it.
        max_step: factor by which one refit may change the next size.
    """

    tolerance: float = 0.12
    max_refits: int = 6
    size_range: tuple[float, float] = (1e-5, 30.0)
    min_excess: float = 1e-3
    min_growth: float = 0.2
    max_step: float = 30.0


DEFAULT_SEARCH = ScaleSearch()


@dataclass(frozen=True, slots=True)
class ComposedTrial:
    """A secret with its two recordings (search and test), their noise, and the oracle."""

    secret: Secret
    noise: TrueNoise
    runs: tuple[SimulatedRun, SimulatedRun]
    oracle: Oracle


def compose_trial(
    kind: str,
    trial_type: str,
    rng: np.random.Generator,
    seconds: float | None = None,
    disturbed: DisturbanceKind | None = None,
    *,
    max_draws: int = 30,
) -> ComposedTrial:
    """Draw one trial.

    Args:
        kind: the kind of rig.
        trial_type: a key of ``EFFECT_COUNTS``.
        rng: the source of randomness.
        seconds: duration of each recording, s; None for that of the bench.
        disturbed: what disturbs the rig beside the concealed effects.
        max_draws: number of attempts.

    Raises:
        RunError: no drawn secret can have its target strengths.
    """
    bench = bench_of(kind, seconds)
    for _ in range(max_draws):
        setup = bench.draw_setup(rng)
        secret = Secret(setup, setup.draw_baseline_parameters(rng))
        try:
            noise = setup.true_noise(secret)
            secret = replace(secret, effects=tuple(_draw_effects(secret, noise, trial_type, rng, max_draws)))
            if disturbed is not None:
                secret = _add_disturbance(secret, noise, disturbed, rng)
            return record_secret(secret, noise)
        except (UsageError, RecordingError):
            continue  # a plant that hits its stops or runs away makes no trial
    raise RunError(f"no trial of {kind} with {trial_type} effects could be drawn in {max_draws} attempts")


def record_secret(secret: Secret, noise: TrueNoise) -> ComposedTrial:
    """Simulate the search and test recordings of a secret.

    Raises:
        UsageError: the plant cannot be run like that.
    """
    setup = secret.setup
    runs = setup.simulate(secret, noise, 0), setup.simulate(secret, noise, 1)
    search, test = (setup.to_record(run) for run in runs)
    model = model_for(parse_rig(setup.rig, Path("rig.toml")), search)
    values = model_values(model, setup.plant_parameters(secret))
    return ComposedTrial(secret, noise, runs, Oracle.build(model, search, test, noise, values))


def make_answer(trial: ComposedTrial, name: str, recordings: dict[str, str]) -> Answer:
    """Compute what every effect is worth by refits with and without it, and return the answer.

    Args:
        trial: the trial.
        name: its name.
        recordings: SHA-256 of its recordings by role.
    """
    oracle, secret = trial.oracle, trial.secret
    baseline = rig_model(secret.kind).baseline
    known = _known_terms(trial)
    full = [*baseline, *known]
    without = {name: oracle.refit([term for term in full if term != name]) for name in known}
    best = oracle.refit(full).best_of(*without.values())
    theta = best.theta
    floors = oracle.noise_floors(theta, oracle.test_score(theta))
    baseline_fit = oracle.refit(baseline).theta if known else theta
    return Answer(
        trial=name,
        rig=secret.kind,
        recordings=recordings,
        baseline=tuple(baseline),
        effects=tuple(_effect(trial, drawn, without.get(drawn.key), best) for drawn in secret.effects),
        truth=oracle.values,
        noise=trial.noise,
        noise_floors=dict(zip(oracle.test.output_names, floors.tolist(), strict=True)),
        baseline_strength=oracle.strength(baseline_fit),
        conditions=_conditions(secret),
        plant=secret.parameters,
    )


def _conditions(secret: Secret) -> dict[str, Any]:
    """Conditions of the recordings, with the disturbance."""
    conditions = secret.setup.conditions_to_json()
    return (
        conditions
        if secret.disturbance is None
        else {**conditions, "disturbance": asdict(secret.disturbance)}
    )


def _effect(trial: ComposedTrial, drawn: DrawnEffect, without: Refit | None, full: Refit) -> TrueEffect:
    """Compute strength and gain of an effect; ``without`` is None for one outside the catalogue."""
    oracle = trial.oracle
    if without is not None:
        reduced_model, gain = without, full.likelihood - without.likelihood
    else:
        setup = trial.secret.setup
        silent = setup.to_record(setup.simulate_noiseless(trial.secret, trial.runs[1], 1))
        reduced_model, gain = full, oracle.log_likelihood_of_truth(full.theta, silent) - full.likelihood
    return TrueEffect(
        term=drawn.term,
        joint=drawn.joint,
        catalogue=without is not None,
        plant=drawn.parameters,
        parameters={
            p.key: oracle.values[p.key]
            for p in oracle.model.parameters
            if p.term == drawn.key and p.key in oracle.values
        },
        strength=oracle.strength(reduced_model.theta),
        oracle_gain=gain,
    )


def _known_terms(trial: ComposedTrial) -> list[str]:
    """Effects that the model has a term for."""
    return [effect.key for effect in trial.secret.effects if effect.key in trial.oracle.model.terms]


def _draw_effects(
    secret: Secret, noise: TrueNoise, trial_type: str, rng: np.random.Generator, max_draws: int
) -> list[DrawnEffect]:
    """Draw the effects of a trial type, each scaled to its target strength."""
    effects: list[DrawnEffect] = []
    if not EFFECT_COUNTS[trial_type][0]:
        return effects
    model = record_secret(secret, noise).oracle.model
    for _ in range(max_draws if trial_type != BRISTLES else 10 * max_draws):
        if len(effects) == EFFECT_COUNTS[trial_type][0]:
            return (
                [*effects, secret.setup.draw_carrier(effects[0], rng)] if trial_type == BRISTLES else effects
            )
        drawn = secret.setup.draw_effect(model, trial_type == "hidden", effects, rng)
        if trial_type == BRISTLES and not drawn.is_dry_friction:
            continue
        scaled = _scale_to_target(replace(secret, effects=tuple(effects)), drawn, noise)
        if scaled is not None:
            effects.append(scaled)
    raise UsageError(f"no {trial_type} effects of {secret.kind} could be scaled")


def _scale_to_target(
    secret: Secret, drawn: DrawnEffect, noise: TrueNoise, first_factor: float = 0.2
) -> DrawnEffect | None:
    """Scale an effect to its target strength beside the secret's other effects; None where it cannot have it.

    The strength is the excess of the squared RMSE over that of the same bench without the effect. The search
    begins at ``first_factor``: small effects are refitted faster, and their excess grows as expected.
    """
    baseline_strength = _strength(secret, None, noise, drawn.joint)
    factor = _find_factor(
        lambda factor: _strength(secret, drawn.scaled(factor), noise, drawn.joint),
        baseline_strength,
        drawn.target_strength,
        first_factor,
    )
    return None if factor is None else drawn.scaled(factor)


def _add_disturbance(
    secret: Secret,
    noise: TrueNoise,
    kind: DisturbanceKind,
    rng: np.random.Generator,
    first_size: float = 0.02,
) -> Secret:
    """Add a disturbance of a drawn size, in noise levels of the RMSE of a model of everything else.

    The search begins at ``first_size``, in the command's unit or a share of its gain.
    """
    unit = Disturbance.draw(kind, rng)
    noise_levels = float(rng.uniform(*SIZE_RANGE))

    def with_size(size: float) -> Secret:
        return replace(secret, disturbance=replace(unit, size=size))

    size = _find_factor(
        lambda factor: _strength(with_size(factor), None, noise, None),
        _strength(secret, None, noise, None),
        math.hypot(1.0, noise_levels),
        first_size,
    )
    if size is None:
        raise UsageError(f"no {kind} at the drive of {secret.kind} could be scaled")
    return with_size(size)


def _find_factor(
    strength_at: Callable[[float], float],
    baseline_strength: float,
    target: float,
    factor: float,
    options: ScaleSearch = DEFAULT_SEARCH,
) -> float | None:
    """Find the factor at which the excess over ``baseline_strength`` makes a strength of ``target``.

    The excess grows about as the square of a small effect, so the search is a secant on logarithms. Returns
    None where there is no such factor.
    """
    target_excess = math.log(target**2 - 1.0)
    slope = 2.0
    previous: tuple[float, float] | None = None
    for _ in range(options.max_refits):
        try:
            strength = strength_at(factor)
        except (UsageError, RecordingError):
            factor /= 3.0  # so strong that the plant cannot be run
            continue
        excess = max(strength**2 - baseline_strength**2, options.min_excess)
        distance = abs(math.log(math.sqrt(1.0 + excess) / target))
        if distance < options.tolerance and excess > options.min_excess:
            return factor
        current = math.log(factor), math.log(excess)
        if previous is not None and abs(current[0] - previous[0]) > 1e-6:
            growth = (current[1] - previous[1]) / (current[0] - previous[0])
            if growth < options.min_growth:
                return None
            slope = min(growth, 8.0)
        previous = current
        max_step = math.log(options.max_step)
        step = min(max((target_excess - current[1]) / slope, -max_step), max_step)
        factor = math.exp(current[0] + step)
        if not options.size_range[0] <= factor <= options.size_range[1]:
            return None
    return None


def _strength(secret: Secret, drawn: DrawnEffect | None, noise: TrueNoise, joint: int | None) -> float:
    """Refit all effects but ``drawn``, and return the strength in the outputs of the joint."""
    extra = () if drawn is None else (drawn,)
    trial = record_secret(replace(secret, effects=(*secret.effects, *extra)), noise)
    others = [key for key in _known_terms(trial) if drawn is None or key != drawn.key]
    theta = trial.oracle.fit_on_windows([*rig_model(secret.kind).baseline, *others])
    return trial.oracle.strength(theta, joint)
