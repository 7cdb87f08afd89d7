"""A payload that explains changed inertial parameters of an arm.

A mass at the flange of an arm changes a dozen inertial parameters at once, each by what a point mass at the
flange adds to it. One mass and its centre are fitted to these changes, weighted by their covariance. Where
the payload explains them, it is the answer, and the parameters keep the values of the user's model.
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
from labhil.identify.fitted import Fitted
from labhil.physics.model import Model, index_of
from labhil.signals import FloatArray

PAYLOAD_TERM = "payload"
PAYLOAD_KEYS = ("payload.mass", "payload.centre_x", "payload.centre_y", "payload.centre_z")


@runtime_checkable
class HasPayload(Model, Protocol):
    """A model that states what a payload adds to its parameters.

    Attributes:
        scale_error: relative standard error of the scale of all forces.
    """

    scale_error: float

    def sizes_of_load(self, mass: float, centre: Sequence[float]) -> Mapping[str, float]:
        """What a point mass adds to the parameters of the model.

        Args:
            mass: the mass, kg.
            centre: its centre in the frame of the flange, (3,), m.

        Returns:
            Change of each parameter by key, SI units; empty where none of them is estimated.
        """
        ...


@dataclass(frozen=True, slots=True)
class Load:
    """A payload, mass (kg) and centre (m): ``values`` (4,) with their standard ``errors`` (4,)."""

    values: FloatArray
    errors: FloatArray


def explain_by_load(data: Data, result: SearchResult, accepted: Accepted | None) -> SearchResult:
    """State changes of accepted parameters as a payload where one explains them.

    Args:
        data: the data of the search.
        result: the result of the search.
        accepted: the accepted model, if there is one.

    Returns:
        The result with the payload as a named term, or ``result`` itself.
    """
    model = data.model
    if accepted is None or not isinstance(model, HasPayload) or PAYLOAD_TERM not in model.terms:
        return result
    if PAYLOAD_TERM in result.final.terms or not model.sizes_of_load(1.0, (0.0, 0.0, 0.0)):
        return result
    load = find_load(model, result.final, accepted)
    if load is None:
        return result
    loaded = drop_minor_terms(data, _state_load(data, model, result, load, accepted))
    return _refine_load(data, model, result, loaded, accepted)


def _refine_load(
    data: Data, model: HasPayload, result: SearchResult, loaded: SearchResult, accepted: Accepted
) -> SearchResult:
    """Estimate the load again without terms that became minor beside it: they bias its parameters."""
    if not loaded.minor:
        return loaded
    steps = tuple(step for step in result.missing if step.terms[0] in loaded.final.terms)
    final = refit(data, result.final, [term for term in loaded.final.terms if term != PAYLOAD_TERM], ())
    load = find_load(model, final, accepted)
    if load is None:
        return loaded
    reloaded = _state_load(data, model, replace(result, final=final, missing=steps), load, accepted)
    return replace(reloaded, minor=loaded.minor)


def find_load(
    model: HasPayload,
    fitted: Fitted,
    accepted: Accepted,
    *,
    min_explained_share: float = 0.9,
    min_mass_in_errors: float = 5.0,
    max_distance: float = 0.5,
) -> Load | None:
    """Find the payload that explains how estimates differ from accepted values.

    A parameter that the accepted model lacks did not differ from zero there: it counts as zero, with the
    error that it has in this fit.

    Args:
        model: the model of the arm.
        fitted: its fit.
        accepted: the accepted model.
        min_explained_share: share of the squared changes, in units of their errors, that the payload has to
            explain.
        min_mass_in_errors: standard errors by which its mass has to differ from zero.
        max_distance: largest distance of its centre from the flange along each axis, m, as the term has it.

    Returns:
        The payload, or None where none explains the changes.
    """
    keys = [key for key in model.sizes_of_load(1.0, (0.0, 0.0, 0.0)) if key in _free_keys(fitted)]
    if len(keys) < len(PAYLOAD_KEYS) or not set(keys) & set(accepted.values):
        return None
    robust, _, _ = fitted.covariances
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

    bounds = ([0.0, *[-max_distance] * 3], [np.inf, *[max_distance] * 3])
    solutions = [
        least_squares(whitened_residuals, [mass, 0.0, 0.0, 0.05], bounds=bounds, x_scale=0.1)
        for mass in (0.3, 3.0)
    ]
    solution = min(solutions, key=lambda candidate: float(candidate.cost))
    before, after = float(np.sum(whitened_residuals(np.zeros(4)) ** 2)), 2.0 * float(solution.cost)
    # changes that a point mass does not explain show by how much their errors are too small
    inflation = max(after / max(len(keys) - len(PAYLOAD_KEYS), 1), 1.0)
    # without a mass its centre has no effect, and rounding may make its zero variance negative
    errors = np.sqrt(inflation * np.maximum(np.diag(np.linalg.pinv(solution.jac.T @ solution.jac)), 0.0))
    is_certain = (
        solution.x[0] > min_mass_in_errors * errors[0] and after < (1.0 - min_explained_share) * before
    )
    return Load(np.asarray(solution.x), errors) if is_certain else None


def _state_load(
    data: Data, model: HasPayload, result: SearchResult, load: Load, accepted: Accepted
) -> SearchResult:
    """The result with the load as a term, if held-out data support it."""
    places = index_of(model.parameters)
    added = model.sizes_of_load(float(load.values[0]), load.values[1:].tolist())
    theta = result.final.theta.copy()
    for key, change in added.items():
        # another effect, not the load, now has to explain the rest of the change
        theta[places[key]] = accepted.values.get(key, theta[places[key]] - change)
    for key, value in zip(PAYLOAD_KEYS, load.values.tolist(), strict=True):
        theta[places[key]] = value
    held = replace(data, held=data.held | set(added))
    begin = replace(result.final, theta=theta)
    final = refit(held, begin, (*result.final.terms, PAYLOAD_TERM), ())
    bare = refit(held, begin, result.final.terms, ())
    effective = effective_samples(final)
    gain, p_value = best_heldout_gain(held.score_held_out(bare.theta), held.score_held_out(final.theta))
    evidence = Evidence(bic(final, effective) - bic(bare, effective), p_value, gain)
    p_search = search_p_value(bare, final, effective, result.n_candidates)
    if not is_supported(evidence, p_search):
        return result
    baseline = refit(held, begin, result.baseline.terms, ())
    errors = dict(zip(PAYLOAD_KEYS, load.errors.tolist(), strict=True))
    errors[PAYLOAD_KEYS[0]] = float(np.hypot(load.errors[0], model.scale_error * load.values[0]))
    errors |= {key: float(np.sqrt(accepted.covariance_of([key])[0, 0])) for key in added}
    step = Step((PAYLOAD_TERM,), evidence, p_search)
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
    """Keys of the fitted parameters."""
    return list(fitted.estimates)
