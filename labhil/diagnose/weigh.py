"""Whether each found term is the right one, is needed, and is told: rivals in its place, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from labhil.diagnose.evidence import bic, effective_samples, unlikelier
from labhil.diagnose.foretold import compare, foretold
from labhil.diagnose.found import Rival, Step, Trail
from labhil.diagnose.judge import NEEDED_BIC, Data, supported
from labhil.diagnose.refit import FINALISTS, confirm, refit, without
from labhil.diagnose.screen import Progress, Screen
from labhil.diagnose.structures.enumerate import candidates
from labhil.identify.fitted import Fitted, covariances
from labhil.identify.known import Known
from labhil.identify.statistics import nonzero
from labhil.identify.waves import MOST
from labhil.physics.model import index_of
from labhil.signals import FloatArray

RELEVANT, RELEVANT_BESIDE = 0.05, 0.5
"""A term has to explain this share of the baseline's squared residuals beyond noise, or this of what is left.

On precise recordings of real mechanisms there is always a further term that chance does not explain.
"""

ON_THE_WAY = 0.2
"""Share of that with which a search goes on: a term shows its size when those in its place are gone."""

REPEATS = 0.025
"""Level at which held-out data by themselves have to tell what repeats along the way.

The best of 150 orders finds waves in the rounding of the searched ones.
"""

LEAST = 25.0
"""Squares of noise that a term has to explain, whatever the noise is taken for: rounding is no noise."""

WEIGHED, WEIGHED_WIDELY = (2, 0.5), (5, 0.1)
"""How many rivals are tried in the place of each found term, and what share of what its absence leaves they
have to promise: on long windows, where a projection says less, more of them and with less."""

HOPELESS = 3.0
"""A fit whose squared residuals stay above this many times those of the model to beat is not finished."""

RIVAL_BIC = 10.0
"""A rival within this stays on the list: it is under five nats behind."""

FAR_BEHIND = 50.0
"""A rival that the searched data put this far behind needs no other data."""


def swapped(
    data: Data, trail: Trail, base: frozenset[str], executor: Executor, progress: Progress, *, widely: bool
) -> tuple[Fitted, tuple[Rival, ...]]:
    """Try the best-screened rivals in the place of each found term; keep what both kinds of data prefer."""
    current, rivals = trail.current, list[Rival]()
    for term in [t for t in current.terms if t not in base]:
        if term not in current.terms:
            continue
        reduced = _without(data, current, term)
        absent = [group for group in candidates(data.model, reduced.terms) if term not in group]
        groups = [group for group in absent if group[-1] not in current.terms]
        groups = _hopeful(data, current, reduced, groups, executor, *(WEIGHED_WIDELY if widely else WEIGHED))
        narrowed = _narrowed(data, current, term)
        if not groups and not narrowed:
            continue
        names = [*(trial.terms[-1] for trial in narrowed), *(group[-1] for group in groups)]
        progress(f"weighing {', '.join(names)} instead of {term}")
        left, effective = foretold(data, current), effective_samples(current)
        known = bic(current, effective)
        worst = min(bic(reduced, effective) - known, FAR_BEHIND)
        others = confirm(data, reduced, groups, executor, HOPELESS * current.solution.cost, current)
        for trial in [*narrowed, *others[:FINALISTS]]:
            seen = bic(trial, effective) - known
            if seen >= worst:
                continue  # no better than nothing, or far behind: no rival, whatever held-out data say
            rival, delta = trial.terms[-1], seen + unlikelier(left, foretold(data, trial))
            if delta < 0.0 and trail.may_go(trial):
                rivals.append(Rival(term, rival, -delta))
                current = trial
                break
            rivals.append(Rival(rival, term, delta))
    return current, tuple(r for r in rivals if abs(r.delta_bic) < RIVAL_BIC)


def _narrowed(data: Data, current: Fitted, term: str) -> list[Fitted]:
    """The model with what a found term becomes when its shape has no width, begun at that term's size."""
    narrow = data.model.terms[term].narrow
    if not narrow or narrow in current.terms:
        return []
    places = index_of(data.model.parameters)
    theta = current.theta.copy()
    size, own = (places[data.model.terms[key].parameters[0].key] for key in (narrow, term))
    theta[size] = max(theta[own], 0.0)
    return [
        refit(data, replace(current, theta=theta), (*without(data.model, current.terms, term), narrow), ())
    ]


def _hopeful(
    data: Data,
    current: Fitted,
    reduced: Fitted,
    groups: Sequence[tuple[str, ...]],
    executor: Executor,
    most: int,
    share: float,
) -> list[tuple[str, ...]]:
    """The groups that promise most beside the reduced model.

    At most so many, and at least this share of what the absence of the term in question leaves.
    """
    screen = Screen.of(data, reduced)
    columns = list(executor.map(screen.columns_of, groups))
    promises = [screen.promise([own], group) for own, group in zip(columns, groups, strict=True)]
    wanted = share * (1.0 - current.solution.cost / reduced.solution.cost)
    return [groups[i] for i in np.argsort(promises)[::-1][:most] if promises[i] > wanted]


def relevant(baseline: Fitted, before: Fitted, after: Fitted, share: float = 1.0) -> bool:
    """Whether a step explains enough, or a ``share`` of that, of what the baseline leaves unexplained."""
    at_first, left = (fitted.solution.cost - fitted.dof for fitted in (baseline, before))
    needed = max(share * min(RELEVANT * at_first, RELEVANT_BESIDE * left), LEAST)
    return before.solution.cost - after.solution.cost > needed


def _worth_telling(data: Data, baseline: Fitted, before: Fitted, after: Fitted) -> bool:
    """Whether a step explains enough of the searched data, or a little of these and enough of the others."""
    return relevant(baseline, before, after) or (
        relevant(baseline, before, after, ON_THE_WAY) and _shown(data, baseline, before, after)
    )


def _shown(data: Data, baseline: Fitted, before: Fitted, after: Fitted) -> bool:
    """Whether a step explains enough of what the baseline leaves of the held-out data.

    What acts rarely may hardly act in the recording that was searched.
    """
    at_first, left, rest = (
        float(np.mean(foretold(data, fitted).residuals ** 2)) for fitted in (baseline, before, after)
    )
    return left - rest > RELEVANT * (at_first - 1.0)


def _significant(fitted: Fitted, term: str) -> bool:
    """Whether the sizes of a term, all together, are told from zero; evidence alone judges one with a shape.

    Each of two sizes may be tied to something else: the width of a dead zone is known where its middle is
    not. Waves are the best of many orders. Sizes may be known in units of one of the rig's own only: from a
    motor's speed dry friction and inertia are known over the torque constant, which is not zero.
    """
    own = fitted.problem.model.terms[term]
    if any(p.shape for p in own.parameters) and own.order is None:
        return True
    robust, _, jacobian = covariances(fitted)
    places = index_of(fitted.problem.model.parameters)
    free = fitted.problem.free.tolist()
    sizes = [free.index(places[p.key]) for p in own.parameters if not p.shape and places[p.key] in free]
    values = fitted.theta[fitted.problem.free]
    looks = MOST if own.order else 1
    if nonzero(values[sizes], robust[np.ix_(sizes, sizes)], looks):
        return True
    own_sizes = [j for j in range(len(free)) if fitted.problem.is_size(j) and np.isfinite(robust[j, j])]
    known = Known.of(fitted, jacobian)
    return any(nonzero(*_in_units_of(j, sizes, values, known), looks) for j in own_sizes)


def _in_units_of(
    unit: int, places: list[int], values: FloatArray, known: Known
) -> tuple[FloatArray, FloatArray]:
    """Some of ``values`` (P,) over that at ``unit``, (k,), and their covariance (k, k) to first order."""
    slopes = np.zeros((len(places), len(values)))
    slopes[np.arange(len(places)), places] = 1.0 / values[unit]
    slopes[:, unit] -= values[places] / values[unit] ** 2
    return values[places] / values[unit], known.covariance(slopes)


def _without(data: Data, current: Fitted, term: str) -> Fitted:
    """The model refitted without a term and what builds on it, unless that is hopelessly worse."""
    terms = without(data.model, current.terms, term)
    return refit(data, current, terms, (), hopeless=HOPELESS * current.solution.cost)


def pruned(data: Data, current: Fitted, base: frozenset[str], progress: Progress) -> Fitted:
    """Remove found terms that the search data no longer need."""
    # what builds on others goes first, so that these can go after it; two weak ones must not both go
    effective = effective_samples(current)
    allowed = bic(current, effective) - NEEDED_BIC
    found = [t for t in current.terms if t not in base]
    if len(found) < 2:
        return current
    for term in sorted(found, key=lambda t: -len(data.model.terms[t].with_terms)):
        progress(f"is {term} still needed")
        if any(term in data.model.terms[t].with_terms for t in current.terms):
            continue
        reduced = _without(data, current, term)
        if bic(reduced, effective) < allowed:
            current = reduced
    return current


def supported_only(
    data: Data, baseline: Fitted, final: Fitted, looks: int
) -> tuple[Fitted, tuple[Step, ...]]:
    """Take out, weakest first, whatever search and held-out data do not both support in the last fit.

    What others build on stays for their sake: Stribeck friction on Coulomb friction of hardly any size.
    """
    while True:
        steps = _steps_of(data, baseline, final, looks)
        carriers = {t for term in final.terms for t in data.model.terms[term].with_terms}
        firm = [step for step in steps if step.told and supported(step.evidence, step.p_search)]
        weak = [step for step in steps if step not in firm and step.terms[0] not in carriers]
        if not weak:
            return final, tuple(firm)
        final = refit(data, final, without(data.model, final.terms, weak[-1].terms[0]), (), thorough=True)


def _steps_of(data: Data, baseline: Fitted, final: Fitted, looks: int) -> tuple[Step, ...]:
    """Evidence for each term of the final model: what is lost when it alone is taken out.

    A term that only carries others, its own sizes at zero, is none that was found.
    """
    kept = []
    places = index_of(data.model.parameters)
    for term in [t for t in final.terms if t not in baseline.terms]:
        sizes = [p.key for p in data.model.terms[term].parameters if not p.shape]
        if all(final.theta[places[key]] == 0.0 for key in sizes):
            continue
        reduced = _without(data, final, term)
        evidence, p_search = compare(data, reduced, final, data.judge(reduced.theta), looks)
        alone = data.model.terms[term].order is None or evidence.p_value < REPEATS
        told = alone and _worth_telling(data, baseline, reduced, final) and _significant(final, term)
        kept.append(Step((term,), evidence, p_search, told))
    return tuple(sorted(kept, key=lambda step: step.evidence.delta_bic))
