"""Refit a model from where another fit ended: with more or fewer terms, or on other windows."""

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
    iterations: int = 25,
) -> Fitted:
    """Fit a set of terms, starting where another fit ended.

    Args:
        data: the data of the search.
        current: the fit to start from.
        terms: keys of the terms to fit.
        fresh: those of the terms that are new; the fit starts at each of their start values in turn.
        thorough: whether the initial states of windows are searched thoroughly.
        iterations: steps of least squares, at most.

    Returns:
        The best of the fits.
    """
    return fit_terms(
        data.model,
        data.search,
        terms,
        data.window,
        data.sigma,
        start=with_only(data.model, current.theta, terms),
        states=current.solution.point.states,
        starts=starts_for_added_terms(current, fresh) if fresh else [{}],
        iterations=iterations,
        thorough=thorough,
        held=data.held,
    )


def refit_on_windows(data: Data, fitted: Fitted, *, iterations: int = 25, tolerance: float = 1e-4) -> Fitted:
    """Refit a model on the windows and with the noise of a search.

    Args:
        data: the data of the search, with the length of its windows.
        fitted: the fit to start from; initial states are estimated at its parameters first.
        iterations: steps of least squares, at most.
        tolerance: relative change of the cost at which the fit stops.

    Returns:
        The refitted model; ``fitted`` itself where windows and noise are the same.
    """
    old = fitted.problem
    same = old.record is data.search and np.array_equal(old.sigma, data.sigma)
    if same and abs(fitted.window - data.window) < 1e-9:
        return fitted
    windows = fit_windows(data.search, data.window)
    problem = Problem(old.model, data.search, windows, old.free, fitted.theta, data.sigma)
    states = grow_states(problem, fitted.solution.point.z, FIRST_SECTION_IN_HORIZONS * data.model.horizon)
    return fit_terms(
        data.model, data.search, fitted.terms, data.window, data.sigma, start=fitted.theta, new_terms=(),
        states=states, iterations=iterations, tolerance=tolerance, held=data.held,
    )  # fmt: skip


def without(model: Model, terms: Sequence[str], term: str) -> tuple[str, ...]:
    """Remove a term, and all terms that build on it, from a list.

    Args:
        model: the model that defines the terms.
        terms: keys of terms.
        term: key of the term to remove.

    Returns:
        The remaining keys in the same order.
    """
    return tuple(t for t in terms if t != term and term not in model.terms[t].with_terms)
