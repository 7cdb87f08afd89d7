"""Where an effect truly shows, and how far the reported regimes agree with that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from labhil.campaign.trials.oracle import Oracle
from labhil.campaign.trials.stated_answer import Regime, StatedAnswer
from labhil.identify.fitted import start_theta
from labhil.signals import FloatArray

SHARE = 0.8
"""Of the excess squared error that the true regime holds."""
WIDEST = 0.6
"""Share of the samples beyond which a regime is none."""
BEHIND = ("beam_sine", "beam_rate", "load_")
"""How coordinates behind the way in, and loads, begin: effects there change what the forces are made of."""


def overlap(oracle: Oracle, term: str, others: Sequence[str], stated: StatedAnswer) -> float | None:
    """Intersection over union of reported and true regime of an effect, on the test's scored samples.

    ``term`` is its key and ``others`` are the terms of the true model without it. Where joints have outputs
    of their own, those of the effect's joint count; for an effect without a joint those of the reported
    joint, else of the one where the effect does most. None where there is no regime: the effect exerts no
    force of its own, or shows nearly everywhere.
    """
    theta = start_theta(oracle.model, oracle.values)
    with_it, without = oracle.marks(theta), oracle.marks(oracle.refit(others).theta)
    excess = (without.errors**2 - with_it.errors**2) / oracle.residual_noise.sigma**2
    windows = with_it.windows
    less = _without_term(oracle, theta, term)
    coordinates, coordinates_without = (
        {
            name: values[windows.scored]
            for name, values in oracle.model.coordinates(
                vector, oracle.test, windows.whole, with_it.states
            ).items()
        }
        for vector in (theta, less)
    )
    fed = {
        **coordinates,
        **{name: values for name, values in coordinates_without.items() if name.startswith(BEHIND)},
    }
    force = oracle.model.generalised_force(theta, coordinates) - oracle.model.generalised_force(less, fed)
    joint = oracle.model.terms[term].joint
    joint = stated.joint if joint is None else joint
    if force.ndim == 2:
        joint = int(np.argmax(np.sum(force**2, axis=0))) if joint is None else joint
        force = force[:, joint]
    outputs = [j for j, c in enumerate(with_it.channels) if joint is None or c.joint in (None, joint)]
    true = level_set(np.abs(force), excess[:, outputs].sum(axis=1))
    return (
        None if true is None else agreement(true, inside({**coordinates, term: force}, stated.regimes, term))
    )


def level_set(contribution: FloatArray, excess: FloatArray) -> np.ndarray | None:
    """The smallest level set (n,) of an own contribution that holds 80 % of the excess; None if too wide."""
    total = float(excess.sum())
    if total <= 0.0 or not contribution.any():
        return None
    order = np.argsort(-contribution, kind="stable")
    held = np.cumsum(excess[order]) >= SHARE * total
    level = contribution[order[int(np.argmax(held))]]
    chosen = contribution >= level
    return chosen if chosen.mean() <= WIDEST else None


def inside(
    coordinates: Mapping[str, FloatArray], reported: Sequence[Regime], term: str | None = None
) -> np.ndarray:
    """Which samples lie in any of the reported regimes.

    Those over the effect's own force, by the name of its ``term``, hold from a size on: they reach as far
    as that force does.
    """
    n = len(next(iter(coordinates.values())))
    chosen = np.zeros(n, dtype=bool)
    for regime in reported:
        if regime.coordinate not in coordinates:
            continue
        x, low, high = coordinates[regime.coordinate], regime.low, regime.high
        if regime.coordinate == term:
            low, high = (low, np.inf) if low > 0.0 else (-np.inf, high)
        chosen |= (x >= low) & (x <= high)
    return chosen


def agreement(true: np.ndarray, reported: np.ndarray) -> float:
    """Intersection over union of two sets of samples."""
    union = int(np.count_nonzero(true | reported))
    return int(np.count_nonzero(true & reported)) / union if union else 0.0


def _without_term(oracle: Oracle, theta: FloatArray, term: str) -> FloatArray:
    """The vector with a term's strengths at nothing."""
    less = theta.copy()
    for i, parameter in enumerate(oracle.model.parameters):
        if parameter.term == term and not parameter.shape:
            less[i] = 0.0
    return less
