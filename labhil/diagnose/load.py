"""Changed sizes of a rig that one load explains: an arm that carries something.

Where an arm's inertia is estimated, a mass at its flange changes a dozen parameters at once, each by what a
point at the flange adds to it. These changes, with their covariance, are fitted by one mass and its centre;
where that is all there is to them, the load is the answer, and the sizes stay what the user's model has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.optimize import least_squares

from labhil.diagnose.accepted import Accepted
from labhil.diagnose.evidence import Evidence, best_heldout_gain, bic, effective_samples, search_p_value
from labhil.diagnose.judge import Data, is_supported
from labhil.diagnose.minor import drop_minor_terms
from labhil.diagnose.refit import refit
from labhil.diagnose.search_result import SearchResult, Step
from labhil.identify.fitted import Fitted, covariances
from labhil.physics.model import Model, index_of
from labhil.signals import FloatArray

TERM = "payload"
KEYS = ("payload.mass", "payload.centre_x", "payload.centre_y", "payload.centre_z")
EXPLAINED = 0.9
"""Share of the changes' squares, in units of their errors, that a load has to explain."""

CERTAIN = 5.0
"""Standard errors by which its mass has to differ from zero."""

FARTHEST = 0.5
"""m from the flange's frame within which its centre is sought, as the term has it."""


@runtime_checkable
class HasPayload(Model, Protocol):
    """A model that knows what a load adds to its sizes; ``scale_error`` is a relative one of all forces."""

    scale_error: float

    def sizes_of_load(self, mass: float, centre: Sequence[float]) -> Mapping[str, float]:
        """What a point ``mass`` (kg) at ``centre`` (m) adds to its parameters, by key."""
        ...


@dataclass(frozen=True, slots=True)
class Load:
    """A mass (kg) and its centre (m): ``values`` (4,) with their standard ``errors`` (4,)."""

    values: FloatArray
    errors: FloatArray


def with_load(data: Data, result: SearchResult, accepted: Accepted | None) -> SearchResult:
    """The result, with the changes of the accepted sizes stated as a load where one explains them."""
    model = data.model
    if accepted is None or not isinstance(model, HasPayload) or TERM not in model.terms:
        return result
    if TERM in result.final.terms or not model.sizes_of_load(1.0, (0.0, 0.0, 0.0)):
        return result
    load = load_in(model, result.final, accepted)
    if load is None:
        return result
    loaded = drop_minor_terms(data, _state_load(data, model, result, load, accepted))
    return _refine_load(data, model, result, loaded, accepted)


def _refine_load(
    data: Data, model: HasPayload, result: SearchResult, loaded: SearchResult, accepted: Accepted
) -> SearchResult:
    """Estimate the load again without terms that it made minor: they blurred the sizes that show it."""
    if not loaded.minor:
        return loaded
    steps = tuple(step for step in result.missing if step.terms[0] in loaded.final.terms)
    final = refit(data, result.final, [term for term in loaded.final.terms if term != TERM], ())
    load = load_in(model, final, accepted)
    if load is None:
        return loaded
    reloaded = _state_load(data, model, replace(result, final=final, missing=steps), load, accepted)
    return replace(reloaded, minor=loaded.minor)


def load_in(model: HasPayload, fitted: Fitted, accepted: Accepted) -> Load | None:
    """The load that explains how sizes differ from the accepted ones; None where none does.

    A size that the accepted model does not have did not differ from zero there: it counts as zero, with the
    error that it has here.
    """
    keys = [key for key in model.sizes_of_load(1.0, (0.0, 0.0, 0.0)) if key in _free_keys(fitted)]
    if len(keys) < len(KEYS) or not set(keys) & set(accepted.values):
        return None
    robust, _, _ = covariances(fitted)
    places = [_free_keys(fitted).index(key) for key in keys]
    spread = robust[np.ix_(places, places)]
    values = fitted.theta[fitted.problem.free[places]]
    accepted_values = np.array([accepted.values.get(key, 0.0) for key in keys])
    absent = np.array([key not in accepted.values for key in keys])
    spread = spread + accepted.covariance_of(keys) + np.diag(np.diag(spread) * absent)
    if not np.all(np.isfinite(spread)):
        return None
    whiten = np.linalg.inv(np.linalg.cholesky(spread))

    def whitened_residuals(load: FloatArray) -> FloatArray:
        added = model.sizes_of_load(float(load[0]), load[1:].tolist())
        return np.asarray(whiten @ (values - accepted_values - np.array([added[key] for key in keys])))

    bounds = ([0.0, *[-FARTHEST] * 3], [np.inf, *[FARTHEST] * 3])
    solutions = [
        least_squares(whitened_residuals, [mass, 0.0, 0.0, 0.05], bounds=bounds, x_scale=0.1)
        for mass in (0.3, 3.0)
    ]
    solution = min(solutions, key=lambda candidate: float(candidate.cost))
    before, after = float(np.sum(whitened_residuals(np.zeros(4)) ** 2)), 2.0 * float(solution.cost)
    # the part of the changes that a point does not explain shows how far to trust their errors
    trust = max(after / max(len(keys) - len(KEYS), 1), 1.0)
    # without a mass its centre changes nothing, and rounding may take a variance of zero below that
    errors = np.sqrt(trust * np.maximum(np.diag(np.linalg.pinv(solution.jac.T @ solution.jac)), 0.0))
    certain = solution.x[0] > CERTAIN * errors[0] and after < (1.0 - EXPLAINED) * before
    return Load(np.asarray(solution.x), errors) if certain else None


def _state_load(
    data: Data, model: HasPayload, result: SearchResult, load: Load, accepted: Accepted
) -> SearchResult:
    """The result with the load as a term, if data that the search never saw support it."""
    places = index_of(model.parameters)
    added = model.sizes_of_load(float(load.values[0]), load.values[1:].tolist())
    theta = result.final.theta.copy()
    for key, change in added.items():
        # what a load leaves of a change may have made up for another effect, which has to explain it now
        theta[places[key]] = accepted.values.get(key, theta[places[key]] - change)
    for key, value in zip(KEYS, load.values.tolist(), strict=True):
        theta[places[key]] = value
    held = replace(data, held=data.held | set(added))
    begin = replace(result.final, theta=theta)
    final = refit(held, begin, (*result.final.terms, TERM), ())
    bare = refit(held, begin, result.final.terms, ())
    effective = effective_samples(final)
    gain, p_value = best_heldout_gain(held.judge(bare.theta), held.judge(final.theta))
    evidence = Evidence(bic(final, effective) - bic(bare, effective), p_value, gain)
    p_search = search_p_value(bare, final, effective, result.looks)
    if not is_supported(evidence, p_search):
        return result
    baseline = refit(held, begin, result.baseline.terms, ())
    errors = dict(zip(KEYS, load.errors.tolist(), strict=True))
    errors[KEYS[0]] = float(np.hypot(load.errors[0], model.scale_error * load.values[0]))
    errors |= {key: float(np.sqrt(accepted.covariance_of([key])[0, 0])) for key in added}
    step = Step((TERM,), evidence, p_search)
    rivals = tuple(r for r in result.rivals if r.instead_of in final.terms)
    return replace(
        result,
        baseline=baseline,
        final=final,
        missing=(step, *result.missing),
        rivals=rivals,
        errors=errors,
        alternatives=(),  # none of them has a load
    )


def _free_keys(fitted: Fitted) -> list[str]:
    return list(fitted.estimates)
