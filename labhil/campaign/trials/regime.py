"""The regime in which an effect truly acts, and its agreement with the reported regimes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from labhil.campaign.trials.oracle import Oracle
from labhil.campaign.trials.stated_answer import Regime, StatedAnswer
from labhil.identify.fitted import start_theta
from labhil.signals import FloatArray

DOWNSTREAM_COORDINATES = ("beam_sine", "beam_rate", "load_")
"""Prefixes of coordinates behind the input path and of loads: effects there change those of the forces."""


def overlap(oracle: Oracle, term: str, others: Sequence[str], stated: StatedAnswer) -> float | None:
    """Return the intersection over union of reported and true regime of an effect, on scored test samples.

    Where joints have outputs of their own, those of the effect's joint count; for an effect without a joint
    those of the reported joint, else of the one where its force is largest.

    Args:
        oracle: the oracle of the trial.
        term: key of the effect's term.
        others: the terms of the true model without it.
        stated: the answer with the reported regimes.

    Returns:
        The agreement; None where there is no regime: the effect exerts no force, or acts nearly everywhere.
    """
    theta = start_theta(oracle.model, oracle.values)
    with_term, without_term = oracle.test_score(theta), oracle.test_score(oracle.refit(others).theta)
    excess = (without_term.errors**2 - with_term.errors**2) / oracle.residual_noise.sigma**2
    windows = with_term.windows
    theta_without = _without_term(oracle, theta, term)
    coordinates, coordinates_without = (
        {
            name: values[windows.scored]
            for name, values in oracle.model.coordinates(
                vector, oracle.test, windows.whole, with_term.states
            ).items()
        }
        for vector in (theta, theta_without)
    )
    coordinates_behind = {
        **coordinates,
        **{
            name: values
            for name, values in coordinates_without.items()
            if name.startswith(DOWNSTREAM_COORDINATES)
        },
    }
    force = oracle.model.generalised_force(theta, coordinates) - oracle.model.generalised_force(
        theta_without, coordinates_behind
    )
    joint = oracle.model.terms[term].joint
    joint = stated.joint if joint is None else joint
    if force.ndim == 2:
        joint = int(np.argmax(np.sum(force**2, axis=0))) if joint is None else joint
        force = force[:, joint]
    outputs = [j for j, c in enumerate(with_term.channels) if joint is None or c.joint in (None, joint)]
    true = smallest_level_set(np.abs(force), excess[:, outputs].sum(axis=1))
    return (
        None
        if true is None
        else intersection_over_union(
            true, samples_in_regimes({**coordinates, term: force}, stated.regimes, term)
        )
    )


def smallest_level_set(
    contribution: FloatArray, excess: FloatArray, min_excess: float = 0.8, max_samples: float = 0.6
) -> np.ndarray | None:
    """Return the smallest level set (n,) of a contribution that has most of the excess squared error.

    Args:
        contribution: absolute force of an effect (n,).
        excess: excess squared error without the effect (n,).
        min_excess: share of the excess in the set.
        max_samples: share of the samples above which the set is no regime.

    Returns:
        The set; None where it is no regime.
    """
    total = float(excess.sum())
    if total <= 0.0 or not contribution.any():
        return None
    options = np.argsort(-contribution, kind="stable")
    cumulative = np.cumsum(excess[options]) >= min_excess * total
    level = contribution[options[int(np.argmax(cumulative))]]
    chosen = contribution >= level
    return chosen if chosen.mean() <= max_samples else None


def samples_in_regimes(
    coordinates: Mapping[str, FloatArray], reported: Sequence[Regime], term: str | None = None
) -> np.ndarray:
    """Return which samples are in any of the reported regimes.

    A regime over the effect's own force, named after its ``term``, has no upper limit of the absolute force.
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


def intersection_over_union(true: np.ndarray, reported: np.ndarray) -> float:
    """Return the intersection over union of two sets of samples."""
    union = int(np.count_nonzero(true | reported))
    return int(np.count_nonzero(true & reported)) / union if union else 0.0


def _without_term(oracle: Oracle, theta: FloatArray, term: str) -> FloatArray:
    """Return the vector with a term's strengths at zero."""
    theta_without = theta.copy()
    for i, parameter in enumerate(oracle.model.parameters):
        if parameter.term == term and not parameter.shape:
            theta_without[i] = 0.0
    return theta_without
