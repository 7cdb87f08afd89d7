"""Compose one trial: draw a secret whose effects have the strengths that they are to have, and answer it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.bench import bench_of
from labhil.campaign.trials.draw import (
    COUNTS,
    Drawn,
    Secret,
    candidates,
    draw_base,
    draw_conditions,
    draw_effect,
)
from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.oracle import Oracle, Refit
from labhil.campaign.trials.truth import model_values
from labhil.campaign.trials.world import Walk, loudness, record_of, simulate, truth_of
from labhil.errors import RecordingError, RunError, UsageError
from labhil.identify.score import score
from labhil.physics.rigs import model_for, rig_model
from labhil.plants.rigs import WORLDS
from labhil.rig import parse_rig
from labhil.signals import FloatArray

CLOSE = 0.12
"""Difference of the logarithms of a strength and its target that is close enough."""
REFITS = 6
FIRST_FACTOR = 0.2
"""Where sizes begin: small effects are refitted faster, and grow as they should."""
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


def compose(kind: str, sort: str, random: np.random.Generator) -> Composed:
    """Draw one trial of a sort; RunError where nothing that was drawn can be as strong as it is to be."""
    bench = bench_of(kind)
    for _ in range(DRAWS):
        conditions = draw_conditions(bench, random)
        bare = Secret(kind, conditions, draw_base(bench, conditions, random))
        try:
            noise = loudness(bare)
            effects = _effects(bare, noise, sort, random)
            return composed(replace(bare, effects=tuple(effects)), noise)
        except (UsageError, RecordingError):
            continue  # a plant that hits its stops or runs away makes no trial
    raise RunError(f"no trial of {kind} with {sort} effects could be drawn in {DRAWS} attempts")


def composed(secret: Secret, noise: TrueNoise) -> Composed:
    """Record a secret, search and test; UsageError where the plant cannot be run."""
    bench = bench_of(secret.kind)
    walks = simulate(secret, noise, 0), simulate(secret, noise, 1)
    search, test = (record_of(walk, secret) for walk in walks)
    model = model_for(parse_rig(bench.rig, Path("rig.toml")), search)
    values = model_values(model, _all_numbers(secret))
    return Composed(secret, noise, walks, Oracle.of(model, search, test, noise, values))


def answer_of(found: Composed, name: str, recordings: dict[str, str]) -> Answer:
    """Refit with and without every effect and write down what each is worth."""
    oracle, secret = found.oracle, found.secret
    baseline = rig_model(secret.kind).baseline
    known = _known(found)
    full = [*baseline, *known]
    without = {name: oracle.refit([term for term in full if term != name]) for name in known}
    # what is within a model can never explain less than the model; a search may miss that
    theta = min([oracle.refit(full), *without.values()], key=lambda found: found.cost).theta
    marks = score(oracle.model, theta, oracle.test, found.noise.sigma, oracle.horizon)
    floors = oracle.floors(theta, marks)
    plain = oracle.refit(baseline).theta if known else theta
    return Answer(
        trial=name,
        rig=secret.kind,
        recordings=recordings,
        baseline=tuple(baseline),
        effects=tuple(_effect(found, drawn, without.get(drawn.term), theta) for drawn in secret.effects),
        truth=oracle.values,
        noise=found.noise,
        noise_floors=dict(zip(oracle.test.output_names, floors.tolist(), strict=True)),
        baseline_strength=oracle.strength(plain),
        conditions=asdict(secret.conditions),
        plant=secret.parameters,
    )


def _effect(found: Composed, drawn: Drawn, refit: Refit | None, theta: FloatArray) -> TrueEffect:
    """What an effect is worth: ``refit`` is the model without it, None where no model has it anyway."""
    oracle = found.oracle
    if refit is not None:
        without, best = refit.theta, oracle.log_likelihood(theta)
    else:
        true = truth_of(found.secret, found.walks[1], 1)
        without, best = theta, oracle.log_likelihood_of_truth(theta, true)
    return TrueEffect(
        term=drawn.term,
        joint=None,
        catalogue=refit is not None,
        plant=drawn.parameters,
        parameters={k: v for k, v in oracle.values.items() if k.partition(".")[0] == drawn.term},
        strength=oracle.strength(without),
        oracle_gain=best - oracle.log_likelihood(without),
    )


def _known(found: Composed) -> list[str]:
    """The effects that the model has a term for."""
    terms = {term.name for term in found.oracle.model.terms.values()}
    return [effect.term for effect in found.secret.effects if effect.term in terms]


def _effects(bare: Secret, noise: TrueNoise, sort: str, random: np.random.Generator) -> list[Drawn]:
    """As many effects as the sort asks for, each of the strength drawn for it."""
    effects: list[Drawn] = []
    if not COUNTS[sort][0]:
        return effects
    model = composed(bare, noise).oracle.model
    for _ in range(DRAWS):
        if len(effects) == COUNTS[sort][0]:
            return effects
        names = candidates(model, sort == "hidden", [effect.term for effect in effects])
        drawn = draw_effect(bare.kind, names, random)
        fitting = _scaled(replace(bare, effects=tuple(effects)), drawn, noise)
        if fitting is not None:
            effects.append(fitting)
    raise UsageError(f"no {sort} effects of {bare.kind} could be scaled")


def _scaled(bare: Secret, drawn: Drawn, noise: TrueNoise) -> Drawn | None:
    """The effect with its target's strength beside those that are there, or None where it cannot have it.

    What counts is how much the squared RMSE exceeds that of the same bench without the effect. It grows
    about as the square of a small effect: a secant on logarithms.
    """
    wanted = math.log(drawn.target**2 - 1.0)
    unstirred = _strength(bare, None, noise)
    factor, slope = FIRST_FACTOR, 2.0
    before: tuple[float, float] | None = None
    for _ in range(REFITS):
        sized = drawn.scaled(factor)
        try:
            strength = _strength(bare, sized, noise)
        except (UsageError, RecordingError):
            factor /= 3.0  # so strong that the plant cannot be run
            continue
        excess = max(strength**2 - unstirred**2, LEAST_EXCESS)
        if abs(math.log(math.sqrt(1.0 + excess) / drawn.target)) < CLOSE and excess > LEAST_EXCESS:
            return sized
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


def _strength(bare: Secret, drawn: Drawn | None, noise: TrueNoise) -> float:
    """How strong an effect is beside those that are there: all but it refitted."""
    extra = () if drawn is None else (drawn,)
    found = composed(replace(bare, effects=(*bare.effects, *extra)), noise)
    others = [name for name in _known(found) if drawn is None or name != drawn.term]
    return found.oracle.strength(found.oracle.refit([*rig_model(bare.kind).baseline, *others]).theta)


def _all_numbers(secret: Secret) -> dict[str, float]:
    """Every number of the plant, its defaults included."""
    return WORLDS[secret.kind].resolve(secret.terms, secret.parameters)
