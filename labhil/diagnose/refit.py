"""Refitting of candidates: a few steps each, and to the end where that promises most."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from labhil.diagnose.evidence import bic, effective_samples
from labhil.diagnose.judge import NEEDED_BIC, Data
from labhil.identify.fitted import Fitted, fit_terms, with_only
from labhil.identify.problem import Problem
from labhil.identify.waves import starts_beside
from labhil.identify.window_states import FIRST_GROWN, grow_states
from labhil.identify.windows import fit_windows
from labhil.physics.model import Model

ROUGHLY = 1e-4
"""Share of the cost by which a step has to lower it while candidates are compared: part of a BIC unit."""

LEADING = 0.4
"""Scouts that stay behind the best by more than this share of what it gained are not refitted to the end."""

FINALISTS = 3
"""How many of them are refitted to the end where much is still unexplained."""


def confirm(
    data: Data,
    current: Fitted,
    groups: Sequence[tuple[str, ...]],
    executor: Executor,
    hopeless: float = float("inf"),
    beside: Fitted | None = None,
) -> list[Fitted]:
    """Refit candidates, best first by BIC: a few steps each, and to the end where that promises most.

    They begin at ``current``, and at ``beside`` as well, a model whose place they may take: there the other
    parameters have not made up yet for what is missing.
    """

    def scout(group: tuple[str, ...]) -> Fitted:
        terms = (*current.terms, *group)
        begins = [current] if beside is None else [current, beside]
        scouts = [refit(data, begin, terms, group, hopeless=0.0, tolerance=ROUGHLY) for begin in begins]
        return min(scouts, key=lambda found: found.solution.cost)

    def finish(trial: Fitted) -> Fitted:
        if trial.solution.converged or trial.solution.cost > hopeless:
            return trial
        return refit(data, trial, trial.terms, (), tolerance=ROUGHLY)

    scouts = list(executor.map(scout, groups))
    if not scouts:
        return []
    effective = min(effective_samples(t) for t in scouts)
    marks = [bic(trial, effective) for trial in scouts]
    within = min(marks) + max(NEEDED_BIC, LEADING * (bic(current, effective) - min(marks)))
    leading = [trial for trial, mark in zip(scouts, marks, strict=True) if mark <= within]
    others = [trial for trial, mark in zip(scouts, marks, strict=True) if mark > within]
    trials = [*executor.map(finish, leading), *others]
    effective = min(effective_samples(t) for t in trials)
    return sorted(trials, key=lambda trial: bic(trial, effective))


def finish_best(data: Data, trials: Sequence[Fitted], executor: Executor) -> list[Fitted]:
    """Refit the best few with a second chance for outlying windows, and order them anew."""
    leading = trials[:FINALISTS]
    finished = list(executor.map(lambda t: refit(data, t, t.terms, (), thorough=True), leading))
    effective = min(effective_samples(t) for t in finished)
    return sorted(finished, key=lambda trial: bic(trial, effective))


def refit(
    data: Data,
    current: Fitted,
    terms: Sequence[str],
    fresh: Sequence[str],
    *,
    thorough: bool = False,
    hopeless: float = float("inf"),
    tolerance: float = 1e-6,
) -> Fitted:
    """Fit ``terms`` from where a fit stands; those in ``fresh`` begin at each of their own starts."""
    return fit_terms(
        data.model,
        data.search,
        terms,
        data.window,
        data.sigma,
        start=with_only(data.model, current.theta, terms),
        states=current.solution.point.states,
        starts=starts_beside(current, fresh) if fresh else [{}],
        iterations=25,
        tolerance=tolerance,
        thorough=thorough,
        hopeless=hopeless,
        held=data.held,
    )


def on_windows(data: Data, fitted: Fitted) -> Fitted:
    """Refit on the data's windows and noise, beginning at states that fit these with the parameters kept."""
    old = fitted.problem
    if abs(fitted.window - data.window) < 1e-9 and np.array_equal(old.sigma, data.sigma):
        return fitted
    windows = fit_windows(data.search, data.window)
    problem = Problem(old.model, data.search, windows, old.free, fitted.theta, data.sigma)
    states = grow_states(problem, fitted.solution.point.z, FIRST_GROWN * data.model.horizon)
    return fit_terms(
        data.model, data.search, fitted.terms, data.window, data.sigma, start=fitted.theta, new_terms=(),
        states=states, iterations=25, tolerance=1e-4, held=data.held,
    )  # fmt: skip


def without(model: Model, terms: Sequence[str], term: str) -> tuple[str, ...]:
    """These terms less one and what builds on it."""
    return tuple(t for t in terms if t != term and term not in model.terms[t].with_terms)
