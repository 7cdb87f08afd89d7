"""Practical identifiability: directions of the parameters that the data do not determine.

Sensitivities are by relative changes (log-parameters), so a direction is a product of powers. From voltage
and speed alone, for example, the data determine resistance·inertia: resistance and inductance may grow by any
factor if inertia and friction shrink by it. A direction is weak when its standard error, σ̂ over its singular
value, is larger than one, so that not even its order of magnitude is determined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.statistics import inverse_information
from labhil.physics.terms import Parameter
from labhil.signals import FloatArray, IntArray

WEAK_RELATIVE_ERROR = 1.0
"""Relative standard error beyond which a direction is weak: its order of magnitude is not determined."""

MIN_COMPONENT = 0.05
"""Component of a unit direction from which a parameter counts as part of it."""


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Which parameters, and which of their combinations, the data determine.

    Attributes:
        rank: Number of directions that the data determine.
        of: Number of parameters.
        combinations: Products of powers that are determined where single values are not.
        would_help: Names of channels and known values that would determine more directions.
        singular_values: Those of the sensitivities by relative changes, in units of noise.
    """

    rank: int
    of: int
    combinations: tuple[str, ...]
    would_help: tuple[str, ...]
    singular_values: tuple[float, ...] = ()


def identifiability(
    parameters: Sequence[Parameter],
    values: FloatArray,
    jacobian: FloatArray,
    noise: float,
    *,
    weak_error: float = WEAK_RELATIVE_ERROR,
) -> Identifiability:
    """Find out which parameters and combinations the data determine, from sensitivities.

    Args:
        parameters: P of them.
        values: (P,) SI units.
        jacobian: (N, P) sensitivities in units of noise per SI unit, states projected out.
        noise: Standard deviation of the residuals in units of noise.
        weak_error: Relative standard error beyond which a direction is not determined.
    """
    if not len(values):
        return Identifiability(0, 0, (), ())
    scale, singular, rows = relative_svd(parameters, values, jacobian)
    weak = noise / np.maximum(singular, 1e-300) > weak_error
    names = [p.key for p in parameters]
    # from steps in scales to steps in logarithms; a value of zero has none
    size = np.abs(values)
    logarithmic = np.divide(scale, size, out=np.zeros_like(scale), where=size > 0.0)
    return Identifiability(
        rank=int(np.sum(~weak)),
        of=len(values),
        combinations=invariants(names, rows[weak] * logarithmic) if np.any(weak) else (),
        would_help=(),
        singular_values=tuple(float(s) for s in singular),
    )


def weak_parameters(
    parameters: Sequence[Parameter],
    values: FloatArray,
    jacobian: FloatArray,
    noise: float,
    *,
    weak_error: float = WEAK_RELATIVE_ERROR,
) -> np.ndarray:
    """Mark the parameters of directions that the data do not determine.

    Args:
        parameters: P of them.
        values: (P,) SI units.
        jacobian: (N, P) sensitivities in units of noise per SI unit, states projected out.
        noise: Standard deviation of the residuals in units of noise.
        weak_error: Relative standard error beyond which a direction is not determined.

    Returns:
        (P,) of bool.
    """
    if not len(values):
        return np.empty(0, dtype=bool)
    _, singular, rows = relative_svd(parameters, values, jacobian)
    weak = noise / np.maximum(singular, 1e-300) > weak_error
    return np.asarray(np.any(np.abs(rows[weak]) > MIN_COMPONENT, axis=0))


def undetermined_directions(
    parameters: Sequence[Parameter],
    values: FloatArray,
    jacobian: FloatArray,
    noise: float,
    *,
    undetermined_error: float = 5.0,
) -> tuple[IntArray, np.ndarray]:
    """Choose parameters to hold, so that no direction is left along which a refit could drift by factors.

    Args:
        parameters: P of them.
        values: (P,) SI units.
        jacobian: (N, P) sensitivities in units of noise per SI unit, states projected out.
        noise: Standard deviation of the residuals in units of noise.
        undetermined_error: Relative standard error from which a refit drifts along a direction.

    Returns:
        Indices of the parameters to hold, one for each such direction, and a mask (P,) of all parameters
        that such a direction involves.
    """
    if not len(values):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=bool)
    _, singular, rows = relative_svd(parameters, values, jacobian)
    undetermined = rows[noise / np.maximum(singular, 1e-300) > undetermined_error]
    involved = np.asarray(np.any(np.abs(undetermined) > MIN_COMPONENT, axis=0))
    return np.array(sorted(pivots(undetermined)), dtype=np.int64), involved


def covariance_without(slopes: FloatArray, held: IntArray) -> FloatArray:
    """Covariance of parameters at unit noise, some of them held.

    Args:
        slopes: (N, P) of the residuals, states projected out.
        held: Indices of the parameters to hold (K,).

    Returns:
        (P − K, P − K) of the others.
    """
    kept = np.delete(slopes, held, axis=1)
    unit = np.maximum(np.linalg.norm(kept, axis=0), 1e-300)
    return np.asarray(inverse_information(kept / unit) / np.outer(unit, unit))


def with_helpful_options(
    result: Identifiability, options: Mapping[str, Callable[[], Identifiability]]
) -> Identifiability:
    """Try options (a further channel, a known value) and name those that determine more directions.

    Args:
        result: The identifiability as it is.
        options: By name a function that returns the identifiability with that option; ``of`` may be smaller.

    Returns:
        ``result`` with their names in ``would_help``.
    """
    missing = result.of - result.rank
    if not missing:
        return result
    helpful = [
        name
        for name, evaluate in options.items()
        if (alternative := evaluate()).of - alternative.rank < missing
    ]
    return replace(result, would_help=tuple(helpful))


def relative_svd(
    parameters: Sequence[Parameter], values: FloatArray, jacobian: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Singular value decomposition of a Jacobian by relative changes of the parameters.

    Args:
        parameters: P of them.
        values: (P,) SI units.
        jacobian: (N, P) per SI unit.

    Returns:
        The unit of a relative change (P,), SI, which is a value's size or its scale where that is larger;
        singular values (k,); right singular vectors (k, P).
    """
    scale = np.array([max(abs(v), p.scale) for v, p in zip(values, parameters, strict=True)])
    _, singular, rows = np.linalg.svd(jacobian * scale, full_matrices=False)
    return scale, singular, rows


def invariants(names: Sequence[str], directions: FloatArray) -> tuple[str, ...]:
    """Find products of powers that stay constant when log-parameters move along some directions.

    Every involved parameter beyond k gives one product, with as few other parameters as possible.

    Args:
        names: Names of the P parameters.
        directions: (k, P) steps of their logarithms.

    Example:
        >>> invariants(["a", "b", "c"], np.array([[0.7, 0.7, 0.0]]))
        ('a/b',)
    """
    largest = np.abs(directions).max(axis=1, initial=0.0)
    # parameters at zero have no logarithm: a direction of these alone is left out
    directions = directions[largest > 0.0] / largest[largest > 0.0, None]
    involved = [i for i in range(len(names)) if np.any(np.abs(directions[:, i]) > MIN_COMPONENT)]
    moving = directions[:, involved]
    free = pivots(moving)
    others = [j for j in range(len(involved)) if j not in free]
    texts = []
    for j in others:
        # log x_j − Σ w·log x_free is constant along every direction
        weights, *_ = np.linalg.lstsq(moving[:, free], moving[:, j], rcond=None)
        powers = {names[involved[j]]: 1.0}
        powers = {names[involved[f]]: -float(w) for f, w in zip(free, weights, strict=True)} | powers
        texts.append(_product(powers))
    return tuple(texts)


def pivots(directions: FloatArray) -> list[int]:
    """Choose as many columns as there are rows, the strongest first, by pivoting (first of equals)."""
    remaining = directions.copy()
    chosen: list[int] = []
    for _ in range(len(directions)):
        best = int(np.argmax(np.round(np.linalg.norm(remaining, axis=0), 2)))
        column = remaining[:, best] / max(float(np.linalg.norm(remaining[:, best])), 1e-300)
        remaining = remaining - np.outer(column, column @ remaining)
        chosen.append(best)
    return chosen


def _product(powers: Mapping[str, float]) -> str:
    """Write a product of powers as text, with the first name in the numerator."""
    if next((p for p in powers.values() if abs(p) > MIN_COMPONENT), 1.0) < 0.0:
        powers = {name: -p for name, p in powers.items()}
    numerator = [_power(name, p) for name, p in powers.items() if p > MIN_COMPONENT]
    denominator = [_power(name, -p) for name, p in powers.items() if p < -MIN_COMPONENT]
    return "·".join(numerator) + "".join(f"/{text}" for text in denominator)


def _power(name: str, power: float) -> str:
    """Write a power as text, without an exponent near one."""
    return name if abs(power - 1.0) < MIN_COMPONENT else f"{name}^{power:.2g}"
