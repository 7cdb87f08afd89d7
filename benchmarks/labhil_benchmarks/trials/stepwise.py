"""A method to compare with: forward steps over the same catalogue by the extended BIC, and nothing more.

This is what existing tools for sparse regression do with a library that holds the answers. Candidates are
ordered by what their sensitivities explain of the residuals, the best few are refitted, and the one with the
lowest criterion stays, until none lowers it. It has no held-out data, no rivals, no noise but white one, no
curve for what has no name.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import special

from labhil.analysis.dataset import Dataset
from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit
from labhil.diagnose.structures.prior import candidates
from labhil.identify.fitted import Fitted
from labhil.identify.score import score, scored_horizon
from labhil.identify.table import table_of
from labhil.physics.rigs import rig_model
from labhil.physics.terms import unkeyed
from labhil_benchmarks.trials.screen import Screen

REFITTED = 8
"""How many of the candidates are refitted at each step."""

GAMMA = 1.0
"""Weight of the number of ways to choose as many terms: the strictest that is in use."""

MOST = 8
"""Terms after which no more are looked for: no trial conceals half as many."""


def stepwise_study(dataset: Dataset) -> dict[str, Any]:
    """The method's answer to a trial, as JSON data in the form of a diagnosis, as far as it goes."""
    began = time.perf_counter()
    model = dataset.model
    data = prepare_data(model, dataset.train, dataset.test)
    baseline = fit_baseline(data, rig_model(model.kind).baseline)
    final = select(data, baseline)
    added = [key for key in final.terms if key not in baseline.terms]
    horizon = scored_horizon(model, final.theta, data.test)
    before, after = (score(model, f.theta, data.test, data.test_sigma, horizon) for f in (baseline, final))
    return {
        "schema": "labhil.diagnosis/1",
        "verdict": "missing_physics" if added else "no_mismatch",
        "location": None,
        "missing": [dict(zip(("term", "joint"), unkeyed(key), strict=True)) for key in added],
        "rivals": [],
        "improvement": {
            "per_channel": [
                {"channel": b.channel, "joint": b.joint, "rmse_before": b.rmse, "rmse_after": a.rmse}
                for b, a in zip(before.channels, after.channels, strict=True)
            ]
        },
        "final": {
            "terms": list(final.terms),
            "parameters": [
                {"name": row.name, "joint": row.joint, "ci99": [_end(end) for end in row.ci99]}
                for row in table_of(final).rows
            ],
        },
        "seconds": time.perf_counter() - began,
    }


def select(data: Data, baseline: Fitted) -> Fitted:
    """The model at which no further term lowers the extended BIC."""
    current = baseline
    while len(current.terms) < len(baseline.terms) + MOST:
        groups = _first_few(data, current)
        trials = [refit(data, current, (*current.terms, *group), group, thorough=True) for group in groups]
        best = min(trials, key=lambda trial: extended_bic(baseline, trial), default=current)
        if extended_bic(baseline, best) >= extended_bic(baseline, current):
            break
        current = best
    return current


def extended_bic(baseline: Fitted, fitted: Fitted) -> float:
    """n·ln MSE + k·ln n + 2γ·ln C(P, j) of j terms among P (Chen and Chen, Biometrika 95, 2008, eq. 3).

    Summed over the channels, of which each has a noise level of its own; the residuals count as independent.
    """
    residuals = fitted.solution.residuals.reshape(-1, len(fitted.problem.sigma))
    power = np.maximum(np.mean(residuals**2, axis=0), 1e-300)
    chosen = len(fitted.terms) - len(baseline.terms)
    possible = len(fitted.problem.model.terms) - len(baseline.terms)
    fit = len(residuals) * np.sum(np.log(power))
    size = len(fitted.problem.free) * np.log(residuals.size)
    return float(fit + size + 2.0 * GAMMA * log_ways(possible, chosen))


def log_ways(possible: int, chosen: int) -> float:
    """ln C(P, j): how many models have so many of the possible terms."""
    return float(-special.betaln(1 + possible - chosen, 1 + chosen) - np.log(possible + 1))


def _first_few(data: Data, current: Fitted) -> Sequence[tuple[str, ...]]:
    """The absent terms, with what they build on, whose sensitivities explain most of the residuals."""
    screen = Screen.of(data, current)
    groups = candidates(data.model, current.terms)
    promised = [screen.promise([screen.columns_of(group)], group) for group in groups]
    return [groups[i] for i in np.argsort(promised)[::-1][:REFITTED]]


def _end(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
