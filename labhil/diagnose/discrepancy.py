"""Bias of estimates by model discrepancy, from the residuals and the absent effects of the catalogue.

Only the part of a discrepancy that no parameter absorbs is in the residuals r; the other part is in the
estimates (Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001). The discrepancy is modelled as a mixture of
effects like those of the catalogue. An effect with the response x = J·s + x⊥, J being the sensitivities of
the model, leaves x⊥ and moves the estimates by s. If it caused all of the energy E beyond the noise, it would
have moved them by s·√(E/|x⊥|²). Effects are weighted by the squared correlation of x⊥ and r:

    Var(θ) = Σ_m ρ_m²·s_m²·E/|x⊥_m|² / Σ_m ρ_m²,        ρ_m = x⊥_mᵀr / (|x⊥_m|·|r|).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from labhil.diagnose.structures.enumerate import NOISE_RMS_TOLERANCE
from labhil.diagnose.structures.responses import REPRODUCIBLE_SHARE
from labhil.identify.fitted import Fitted
from labhil.physics.model import index_of
from labhil.physics.terms import Parameter, Term
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class AbsentEffect:
    """A term that a fit lacks, with its main parameter.

    Attributes:
        term: the term.
        parameter: its main parameter.
        response: change of the residuals per scale of that parameter, (N·c,), window states projected out.
    """

    term: Term
    parameter: Parameter
    response: FloatArray


@dataclass(frozen=True, slots=True)
class AbsentEffects:
    """All terms that a fit lacks.

    Attributes:
        fitted: the fit.
        slopes: sensitivities of its residuals to its scaled parameters, (N·c, P), window states projected
            out.
        effects: the terms that it lacks.
    """

    fitted: Fitted
    slopes: FloatArray
    effects: tuple[AbsentEffect, ...]


def absent_effects(fitted: Fitted) -> AbsentEffects:
    """Linearise the response to every term that a fit lacks.

    Args:
        fitted: the fit.

    Returns:
        The responses of the residuals to a small size of each term.
    """
    problem, residuals = fitted.problem, fitted.solution.residuals
    lin = problem.linearise(fitted.solution.point, residuals)
    effects = tuple(
        AbsentEffect(term, main, problem.project(lin, _response(fitted, main)[:, None])[:, 0])
        for key, term in problem.model.terms.items()
        if key not in fitted.terms
        for main in _main_parameters(term)
    )
    return AbsentEffects(fitted, problem.project(lin, lin.by_parameters), effects)


def discrepancy_shifts(absent: AbsentEffects, known: Collection[str] = ()) -> dict[str, float]:
    """Standard deviation of the shift of each estimate by model discrepancy.

    Args:
        absent: the terms that a model fitted to the searched data lacks.
        known: keys of estimates that count as known, such as the coefficients of a curve, which a convention
            separates from the friction of the model.

    Returns:
        Standard deviations by key, SI units; empty where the residuals do not exceed the noise.
    """
    fitted = absent.fitted
    problem, residuals = fitted.problem, fitted.solution.residuals
    energy = float(residuals @ residuals) - NOISE_RMS_TOLERANCE**2 * fitted.dof
    keys = list(fitted.estimates)
    free = [place for place, key in enumerate(keys) if key not in known]
    if energy <= 0.0 or not free:
        return {}
    slopes = absent.slopes[:, free]
    norms = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    inverse = np.linalg.pinv(slopes / norms) / norms[:, None]
    variance, weights = np.zeros(len(free)), 0.0
    for effect in absent.effects:
        shift = inverse @ effect.response
        orthogonal = effect.response - slopes @ shift
        power = float(orthogonal @ orthogonal)
        if power <= REPRODUCIBLE_SHARE * float(effect.response @ effect.response) or power <= 0.0:
            continue
        weight = float(orthogonal @ residuals) ** 2 / power
        variance += weight * shift**2 * (energy / power)
        weights += weight
    errors = np.sqrt(variance / weights) * problem.scale[free] if weights > 0.0 else variance
    return dict(zip((keys[place] for place in free), errors.tolist(), strict=True))


def _main_parameters(term: Term) -> list[Parameter]:
    """The first size of a term, once for each recording that has a value of its own."""
    first = next(p for p in term.parameters if not p.shape)
    return [p for p in term.parameters if p.name == first.name]


def _response(fitted: Fitted, parameter: Parameter, step_in_scale: float = 1e-2) -> FloatArray:
    """Change of the residuals (N·c,) per scale of a parameter at neutral, by a finite difference."""
    theta = fitted.theta.copy()
    theta[index_of(fitted.problem.model.parameters)[parameter.key]] += step_in_scale * parameter.scale
    residuals = fitted.problem.residuals_at(theta, fitted.solution.point.states)
    return np.asarray((residuals - fitted.solution.residuals) / step_in_scale)
