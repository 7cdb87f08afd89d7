"""Compose one trial: draw a secret whose effects have the strengths that they are to have, and answer it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.bench import bench_of
from labhil.campaign.trials.disturbed import SIZES, Disturbance, Kind
from labhil.campaign.trials.draw import BRISTLES, COUNTS
from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.oracle import Oracle, Refit
from labhil.campaign.trials.secret import Drawn, Secret, Walk
from labhil.campaign.trials.truth import model_values
from labhil.errors import RecordingError, RunError, UsageError
from labhil.physics.rigs import model_for, rig_model
from labhil.rig import parse_rig

CLOSE = 0.12
"""Difference of the logarithms of a strength and its target that is close enough."""
REFITS = 6
FIRST_FACTOR = 0.2
"""Where sizes begin: small effects are refitted faster, and grow as they should."""
FIRST_DISTURBANCE = 0.02
"""Of the command's unit, or of its gain."""
FACTORS = (1e-5, 30.0)
LEAST_EXCESS = 1e-3
LEAST_GROWTH = 0.2
"""Power of its size, at least, with which an effect's excess grows that can be scaled."""
DRAWS = 30
"""Effects that are drawn, at most, until one can be as strong as it is to be."""
FARTHEST = 30.0
"""Factor by which one refit may change the next size."""


@dataclass(frozen=True, slots=True)
class Composed:
    """A secret and all that follows from it: the two recordings, their noise, and an oracle."""

    secret: Secret
    noise: TrueNoise
    walks: tuple[Walk, Walk]
    oracle: Oracle


def compose(
    kind: str,
    sort: str,
    random: np.random.Generator,
    seconds: float | None = None,
    disturbed: Kind | None = None,
) -> Composed:
    """Draw one trial of a sort, ``seconds`` long (None: as long as the bench has them), or ``disturbed``.

    RunError where nothing that was drawn can be as strong as it is to be.
    """
    bench = bench_of(kind, seconds)
    for _ in range(DRAWS):
        setup = bench.setup(random)
        bare = Secret(setup, setup.draw_base(random))
        try:
            noise = setup.noise_scale(bare)
            secret = replace(bare, effects=tuple(_effects(bare, noise, sort, random)))
            if disturbed is not None:
                secret = _add_disturbance(secret, noise, disturbed, random)
            return record_secret(secret, noise)
        except (UsageError, RecordingError):
            continue  # a plant that hits its stops or runs away makes no trial
    raise RunError(f"no trial of {kind} with {sort} effects could be drawn in {DRAWS} attempts")


def record_secret(secret: Secret, noise: TrueNoise) -> Composed:
    """Record a secret, search and test; UsageError where the plant cannot be run."""
    setup = secret.setup
    walks = setup.walk(secret, noise, 0), setup.walk(secret, noise, 1)
    search, test = (setup.record(walk) for walk in walks)
    model = model_for(parse_rig(setup.rig, Path("rig.toml")), search)
    values = model_values(model, setup.numbers(secret))
    return Composed(secret, noise, walks, Oracle.of(model, search, test, noise, values))


def answer_of(trial: Composed, name: str, recordings: dict[str, str]) -> Answer:
    """Refit with and without every effect and write down what each is worth."""
    oracle, secret = trial.oracle, trial.secret
    baseline = rig_model(secret.kind).baseline
    known = _known_terms(trial)
    full = [*baseline, *known]
    without = {name: oracle.refit([term for term in full if term != name]) for name in known}
    best = oracle.refit(full).or_better(*without.values())
    theta = best.theta
    floors = oracle.floors(theta, oracle.marks(theta))
    plain = oracle.refit(baseline).theta if known else theta
    return Answer(
        trial=name,
        rig=secret.kind,
        recordings=recordings,
        baseline=tuple(baseline),
        effects=tuple(_effect(trial, drawn, without.get(drawn.key), best) for drawn in secret.effects),
        truth=oracle.values,
        noise=trial.noise,
        noise_floors=dict(zip(oracle.test.output_names, floors.tolist(), strict=True)),
        baseline_strength=oracle.strength(plain),
        conditions=_conditions(secret),
        plant=secret.parameters,
    )


def _conditions(secret: Secret) -> dict[str, Any]:
    """The conditions of the recordings, with the disturbance."""
    conditions = secret.setup.conditions_to_json()
    return (
        conditions
        if secret.disturbance is None
        else {**conditions, "disturbance": asdict(secret.disturbance)}
    )


def _effect(trial: Composed, drawn: Drawn, without: Refit | None, full: Refit) -> TrueEffect:
    """What an effect is worth: ``without`` is the model less it, None where no model has it anyway."""
    oracle = trial.oracle
    if without is not None:
        less, gain = without, full.likelihood - without.likelihood
    else:
        setup = trial.secret.setup
        silent = setup.record(setup.silent(trial.secret, trial.walks[1], 1))
        less, gain = full, oracle.log_likelihood_of_truth(full.theta, silent) - full.likelihood
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
        strength=oracle.strength(less.theta),
        oracle_gain=gain,
    )


def _known_terms(trial: Composed) -> list[str]:
    """The effects that the model has a term for."""
    return [effect.key for effect in trial.secret.effects if effect.key in trial.oracle.model.terms]


def _effects(bare: Secret, noise: TrueNoise, sort: str, random: np.random.Generator) -> list[Drawn]:
    """As many effects as the sort has, each of the strength drawn for it."""
    effects: list[Drawn] = []
    if not COUNTS[sort][0]:
        return effects
    model = record_secret(bare, noise).oracle.model
    for _ in range(DRAWS if sort != BRISTLES else 10 * DRAWS):
        if len(effects) == COUNTS[sort][0]:
            return [*effects, bare.setup.draw_carrier(effects[0], random)] if sort == BRISTLES else effects
        drawn = bare.setup.draw_effect(model, sort == "hidden", effects, random)
        if sort == BRISTLES and not drawn.dry:
            continue
        fitting = _scale_to_target(replace(bare, effects=tuple(effects)), drawn, noise)
        if fitting is not None:
            effects.append(fitting)
    raise UsageError(f"no {sort} effects of {bare.kind} could be scaled")


def _scale_to_target(bare: Secret, drawn: Drawn, noise: TrueNoise) -> Drawn | None:
    """The effect with its target's strength beside those that are there, or None where it cannot have it.

    What counts is how much the squared RMSE exceeds that of the same bench without the effect.
    """
    unstirred = _strength(bare, None, noise, drawn.joint)
    factor = _factor(
        lambda factor: _strength(bare, drawn.scaled(factor), noise, drawn.joint),
        unstirred,
        drawn.target,
        FIRST_FACTOR,
    )
    return None if factor is None else drawn.scaled(factor)


def _add_disturbance(secret: Secret, noise: TrueNoise, kind: Kind, random: np.random.Generator) -> Secret:
    """The secret with a disturbance that leaves so many noise levels beside a model of everything else."""
    unit = Disturbance.draw(kind, random)
    by_noise = float(random.uniform(*SIZES))

    def sized(factor: float) -> Secret:
        return replace(secret, disturbance=replace(unit, size=factor))

    size = _factor(
        lambda factor: _strength(sized(factor), None, noise, None),
        _strength(secret, None, noise, None),
        math.hypot(1.0, by_noise),
        FIRST_DISTURBANCE,
    )
    if size is None:
        raise UsageError(f"no {kind} at the drive of {secret.kind} could be scaled")
    return sized(size)


def _factor(
    strength_at: Callable[[float], float], unstirred: float, target: float, factor: float
) -> float | None:
    """The factor at which a strength beyond the ``unstirred`` one is ``target``; None where there is none.

    The excess grows about as the square of a small effect: a secant on logarithms.
    """
    wanted = math.log(target**2 - 1.0)
    slope = 2.0
    before: tuple[float, float] | None = None
    for _ in range(REFITS):
        try:
            strength = strength_at(factor)
        except (UsageError, RecordingError):
            factor /= 3.0  # so strong that the plant cannot be run
            continue
        excess = max(strength**2 - unstirred**2, LEAST_EXCESS)
        if abs(math.log(math.sqrt(1.0 + excess) / target)) < CLOSE and excess > LEAST_EXCESS:
            return factor
        now = math.log(factor), math.log(excess)
        if before is not None and abs(now[0] - before[0]) > 1e-6:
            grown = (now[1] - before[1]) / (now[0] - before[0])
            if grown < LEAST_GROWTH:
                return None  # the data do not see it, or the baseline takes it up
            slope = min(grown, 8.0)
        before = now
        step = min(max((wanted - now[1]) / slope, -math.log(FARTHEST)), math.log(FARTHEST))
        factor = math.exp(now[0] + step)
        if not FACTORS[0] <= factor <= FACTORS[1]:
            return None
    return None


def _strength(bare: Secret, drawn: Drawn | None, noise: TrueNoise, joint: int | None) -> float:
    """How strong an effect is beside the others, in its joint's outputs: all but it refitted."""
    extra = () if drawn is None else (drawn,)
    trial = record_secret(replace(bare, effects=(*bare.effects, *extra)), noise)
    others = [key for key in _known_terms(trial) if drawn is None or key != drawn.key]
    theta = trial.oracle.rough([*rig_model(bare.kind).baseline, *others])
    return trial.oracle.strength(theta, joint)
