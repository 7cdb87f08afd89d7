"""How far what a model leaves unexplained may have moved its estimates.

Only the part of a discrepancy that no parameter can make up for is left in the residuals r; the other part is
in the estimates (Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001). What is missing is taken for a mixture of
effects like those of the catalogue. One whose response is x = J·s + x⊥, with the model's own slopes J, leaves
x⊥ and moves the estimates by s. If it left all of the energy E beyond the noise, it would have moved them by
s·√(E/|x⊥|²). Effects count by the likeness of x⊥ to r, so that

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

STEP = 1e-2
"""Of a parameter's scale, by which an absent effect is stepped from where it does nothing."""


@dataclass(frozen=True, slots=True)
class AbsentEffect:
    """An effect that a fit lacks, by its first size, and its ``response`` (N·c,) per scale of that."""

    term: Term
    parameter: Parameter
    response: FloatArray


@dataclass(frozen=True, slots=True)
class AbsentEffects:
    """All ``effects`` that a fit lacks, and the ``slopes`` (N·c, P) by its own scaled parameters.

    The windows' own states are taken out of both.
    """

    fitted: Fitted
    slopes: FloatArray
    effects: tuple[AbsentEffect, ...]


def absent_effects(fitted: Fitted) -> AbsentEffects:
    """Simulate every effect that a fit lacks, a little of it, where the fit stands."""
    problem, residuals = fitted.problem, fitted.solution.residuals
    lin = problem.linearise(fitted.solution.point, residuals)
    effects = tuple(
        AbsentEffect(term, main, problem.project(lin, _slope(fitted, main)[:, None])[:, 0])
        for key, term in problem.model.terms.items()
        if key not in fitted.terms
        for main in _main_parameters(term)
    )
    return AbsentEffects(fitted, problem.project(lin, lin.by_parameters), effects)


def discrepancy_shifts(absent: AbsentEffects, known: Collection[str] = ()) -> dict[str, float]:
    """By how much a discrepancy may have moved each estimate, one standard deviation.

    Args:
        absent: the effects that a model fitted to the searched data lacks.
        known: keys of estimates that count as known: a curve's coefficients, which can stand for a friction
            of the model, are kept apart from it by a convention.

    Returns:
        Standard deviations by key, in SI units; empty where nothing is left beyond the noise.
    """
    fitted = absent.fitted
    problem, residuals = fitted.problem, fitted.solution.residuals
    energy = float(residuals @ residuals) - NOISE_RMS_TOLERANCE**2 * fitted.dof
    keys = list(fitted.estimates)
    free = [place for place, key in enumerate(keys) if key not in known]
    if energy <= 0.0 or not free:
        return {}
    slopes = absent.slopes[:, free]
    size = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    inverse = np.linalg.pinv(slopes / size) / size[:, None]
    moved, weights = np.zeros(len(free)), 0.0
    for effect in absent.effects:
        shift = inverse @ effect.response
        orthogonal = effect.response - slopes @ shift
        power = float(orthogonal @ orthogonal)
        if power <= REPRODUCIBLE_SHARE * float(effect.response @ effect.response) or power <= 0.0:
            continue
        likeness = float(orthogonal @ residuals) ** 2 / power
        moved += likeness * shift**2 * (energy / power)
        weights += likeness
    errors = np.sqrt(moved / weights) * problem.scale[free] if weights > 0.0 else moved
    return dict(zip((keys[place] for place in free), errors.tolist(), strict=True))


def _main_parameters(term: Term) -> list[Parameter]:
    """A term's first size, in every recording that has one of its own."""
    first = next(p for p in term.parameters if not p.shape)
    return [p for p in term.parameters if p.name == first.name]


def _slope(fitted: Fitted, parameter: Parameter) -> FloatArray:
    """Change of the residuals (N·c,) per scale of a parameter at neutral, from a small finite step."""
    theta = fitted.theta.copy()
    theta[index_of(fitted.problem.model.parameters)[parameter.key]] += STEP * parameter.scale
    residuals = fitted.problem.residuals_at(theta, fitted.solution.point.states)
    return np.asarray((residuals - fitted.solution.residuals) / STEP)
