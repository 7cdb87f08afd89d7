"""Refitting of more or fewer terms from where a fit stands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labhil.diagnose.judge import Data
from labhil.identify.fitted import Fitted, fit_terms, with_only
from labhil.identify.problem import Problem
from labhil.identify.waves import starts_for_added_terms
from labhil.identify.window_states import FIRST_SECTION_IN_HORIZONS, grow_states
from labhil.identify.windows import fit_windows
from labhil.physics.model import Model


def refit(
    data: Data,
    current: Fitted,
    terms: Sequence[str],
    fresh: Sequence[str],
    *,
    thorough: bool = False,
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
        starts=starts_for_added_terms(current, fresh) if fresh else [{}],
        iterations=25,
        thorough=thorough,
        held=data.held,
    )


def on_windows(data: Data, fitted: Fitted) -> Fitted:
    """Refit on the data's windows and noise, beginning at states that fit these with the parameters kept."""
    old = fitted.problem
    same = old.record is data.search and np.array_equal(old.sigma, data.sigma)
    if same and abs(fitted.window - data.window) < 1e-9:
        return fitted
    windows = fit_windows(data.search, data.window)
    problem = Problem(old.model, data.search, windows, old.free, fitted.theta, data.sigma)
    states = grow_states(problem, fitted.solution.point.z, FIRST_SECTION_IN_HORIZONS * data.model.horizon)
    return fit_terms(
        data.model, data.search, fitted.terms, data.window, data.sigma, start=fitted.theta, new_terms=(),
        states=states, iterations=25, tolerance=1e-4, held=data.held,
    )  # fmt: skip


def without(model: Model, terms: Sequence[str], term: str) -> tuple[str, ...]:
    """These terms less one and what builds on it."""
    return tuple(t for t in terms if t != term and term not in model.terms[t].with_terms)
