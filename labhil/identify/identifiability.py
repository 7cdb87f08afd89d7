"""What the data cannot know: directions in which parameters change nothing, and what is constant along them.

Sensitivities are taken by relative changes (log-parameters), so a direction is a product of powers: from
voltage and speed alone, resistance and inductance times a, inertia and friction divided by a, change
nothing, and resistance·inertia is what is known. A direction is weak when its standard error, σ̂ over its
singular value, is larger than one: the data do not even know its order of magnitude.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.physics.terms import Parameter
from labhil.signals import FloatArray, IntArray

WEAK = 1.0
"""Standard error (in relative units) from which a direction counts as unknown."""

LOST = 20.0
"""Standard error (in relative units) from which nothing can be followed along a direction."""

INVOLVED = 0.05
"""Share of a weak direction from which a parameter counts as part of it."""


@dataclass(frozen=True, slots=True)
class Identifiability:
    """What the data can know of the parameters, by their sensitivities.

    ``rank`` of the directions ``of`` so many parameters are known; ``combinations`` are products of powers
    that are known where single values are not; ``would_help`` names channels and values that would free
    them. ``singular_values`` are those of the sensitivities by relative changes, in units of noise.
    """

    rank: int
    of: int
    combinations: tuple[str, ...]
    would_help: tuple[str, ...]
    singular_values: tuple[float, ...] = ()


def identifiability(
    parameters: Sequence[Parameter], values: FloatArray, jacobian: FloatArray, noise: float
) -> Identifiability:
    """Judge the sensitivities ``jacobian`` (N, P), in units of noise per SI unit, at ``values`` (P,).

    ``noise`` is the standard deviation of the residuals in the same units.
    """
    if not len(values):
        return Identifiability(0, 0, (), ())
    scale, singular, rows = relative_svd(parameters, values, jacobian)
    weak = noise / np.maximum(singular, 1e-300) > WEAK
    names = [p.key for p in parameters]
    # from steps in scales to steps in logarithms; what is zero has none
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
    parameters: Sequence[Parameter], values: FloatArray, jacobian: FloatArray, noise: float
) -> np.ndarray:
    """Which parameters take part in a direction that the data do not know, (P,) of bool."""
    if not len(values):
        return np.empty(0, dtype=bool)
    _, singular, rows = relative_svd(parameters, values, jacobian)
    weak = noise / np.maximum(singular, 1e-300) > WEAK
    return np.asarray(np.any(np.abs(rows[weak]) > INVOLVED, axis=0))


def lost_directions(
    parameters: Sequence[Parameter], values: FloatArray, jacobian: FloatArray, noise: float
) -> tuple[IntArray, np.ndarray]:
    """Places of parameters which, held, leave no direction that is lost, and all that take part in one (P,).

    Along a lost direction parameters may change by factors and the data do not see it.
    """
    if not len(values):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=bool)
    _, singular, rows = relative_svd(parameters, values, jacobian)
    lost = rows[noise / np.maximum(singular, 1e-300) > LOST]
    involved = np.asarray(np.any(np.abs(lost) > INVOLVED, axis=0))
    return np.array(sorted(_pivots(lost)), dtype=np.int64), involved


def what_would_help(
    finding: Identifiability, options: Mapping[str, Callable[[], Identifiability]]
) -> Identifiability:
    """Try each option (a further channel, a known value) and keep the names of those that free a direction.

    An option gives the identifiability that it would lead to, where ``of`` may be smaller.
    """
    lacking = finding.of - finding.rank
    if not lacking:
        return finding
    helpful = [
        name for name, judge in options.items() if (alternative := judge()).of - alternative.rank < lacking
    ]
    return replace(finding, would_help=tuple(helpful))


def relative_svd(
    parameters: Sequence[Parameter], values: FloatArray, jacobian: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What a relative change at ``values`` (P,) is, (P,); singular values (k,) of slopes (N, P) by these.

    It is one of a value's size, or of its scale where that is larger. Last come the directions, (k, P).
    """
    scale = np.array([max(abs(v), p.scale) for v, p in zip(values, parameters, strict=True)])
    _, singular, rows = np.linalg.svd(jacobian * scale, full_matrices=False)
    return scale, singular, rows


def invariants(names: Sequence[str], directions: FloatArray) -> tuple[str, ...]:
    """Products of powers that stay constant when log-parameters move along ``directions`` (k, P).

    Every involved parameter beyond k gives one, written with as few others as the directions allow.

    >>> invariants(["a", "b", "c"], np.array([[0.7, 0.7, 0.0]]))
    ('a/b',)
    """
    largest = np.abs(directions).max(axis=1, initial=0.0)
    # a direction along which only parameters at zero move is none of logarithms
    directions = directions[largest > 0.0] / largest[largest > 0.0, None]
    involved = [i for i in range(len(names)) if np.any(np.abs(directions[:, i]) > INVOLVED)]
    moving = directions[:, involved]
    free = _pivots(moving)
    others = [j for j in range(len(involved)) if j not in free]
    texts = []
    for j in others:
        # log x_j − Σ w·log x_free is constant along every direction
        weights, *_ = np.linalg.lstsq(moving[:, free], moving[:, j], rcond=None)
        powers = {names[involved[j]]: 1.0}
        powers = {names[involved[f]]: -float(w) for f, w in zip(free, weights, strict=True)} | powers
        texts.append(_product(powers))
    return tuple(texts)


def _pivots(directions: FloatArray) -> list[int]:
    """Columns (as many as rows) that together move in all directions: the strongest, the first of equals."""
    remaining = directions.copy()
    chosen: list[int] = []
    for _ in range(len(directions)):
        best = int(np.argmax(np.round(np.linalg.norm(remaining, axis=0), 2)))
        column = remaining[:, best] / max(float(np.linalg.norm(remaining[:, best])), 1e-300)
        remaining = remaining - np.outer(column, column @ remaining)
        chosen.append(best)
    return chosen


def _product(powers: Mapping[str, float]) -> str:
    """As people write it, the first name above the line."""
    if next((p for p in powers.values() if abs(p) > INVOLVED), 1.0) < 0.0:
        powers = {name: -p for name, p in powers.items()}
    above = [_power(name, p) for name, p in powers.items() if p > INVOLVED]
    below = [_power(name, -p) for name, p in powers.items() if p < -INVOLVED]
    return "·".join(above) + "".join(f"/{text}" for text in below)


def _power(name: str, power: float) -> str:
    return name if abs(power - 1.0) < INVOLVED else f"{name}^{power:.2g}"
