"""The search of a diagnosis, and again where sizes of the rig itself are in doubt.

Sizes may have collapsed in the baseline, or the user's own model states them. ``structures/stages.py``
searches once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose.accepted import Accepted
from labhil.diagnose.adequacy import leaves_only_noise
from labhil.diagnose.begin import fit_baseline
from labhil.diagnose.collapsed import are_near_nominal, bound_near_nominal, find_collapsed
from labhil.diagnose.evidence import effective_samples
from labhil.diagnose.judge import VERY_STRONG_DELTA_BIC, Data, is_strongly_favoured
from labhil.diagnose.load import explain_by_load
from labhil.diagnose.minor import drop_minor_terms
from labhil.diagnose.refit import refit, refit_on_windows
from labhil.diagnose.search_result import SearchResult
from labhil.diagnose.structures.stages import search_structures
from labhil.ending import EndedEarly, accept
from labhil.identify.continuation import settle_fit
from labhil.identify.fitted import Fitted
from labhil.physics.model import Metric, Model, index_of


def search_with_sizes(
    data: Data,
    base: Fitted,
    *,
    terms: Sequence[str],
    reference: Mapping[str, float] | None,
    accepted: Accepted | None,
    progress: Callable[[str], None],
) -> SearchResult:
    """Search with all sizes free and, where they contradict those of the user's model, again with these held.

    Args:
        data: the data of the search.
        base: fit of the baseline.
        terms: keys of the baseline's terms.
        reference: values of the user's own model by parameter key.
        accepted: the accepted model that these values are from.
        progress: is called with a line of text at each stage.

    Returns:
        The likelier of both results, without minor terms and with its final fit settled; incomplete where
        the user ended the search early.
    """
    result = search_structures(data, base, progress)
    try:
        if not result.complete:
            return result
        result = _with_credible_sizes(data, result, progress)
        result = explain_by_load(data, result, accepted)
        if reference is not None and not result.errors:
            result = _with_stated_sizes(data, result, terms, reference, progress)
        return _with_settled_fit(drop_minor_terms(data, result))
    except EndedEarly:
        accept()
        return replace(result, complete=False)


def _with_settled_fit(result: SearchResult) -> SearchResult:
    """The result with its final fit in the lowest minimum around.

    The fits of a search end once structures can be compared: in a narrow valley of the cost, such as that of
    both constants of the Stribeck law, that is several standard errors from its bottom.
    """
    if result.final.problem.model.metric is Metric.INVERSE_DYNAMICS:
        return result  # its fit is linear
    return result.with_better_final(settle_fit(result.final))


def _with_credible_sizes(data: Data, result: SearchResult, progress: Callable[[str], None]) -> SearchResult:
    """Search again with bounded sizes where sizes of the rig collapsed in the baseline.

    A nominal value may be wrong, so that the second result counts only if the search data very strongly
    favour it. Where the first result restores the sizes there is no second search.
    """
    collapsed = find_collapsed(data, result.baseline)
    if not collapsed:
        return result
    if result.missing and are_near_nominal(collapsed, result.final):
        return replace(result, collapsed=collapsed)
    near = replace(data, model=bound_near_nominal(data.model, collapsed))
    baseline = fit_baseline(near, result.baseline.terms)
    # without the bounds, on the same windows
    short = fit_baseline(data, result.baseline.terms)
    if not is_strongly_favoured(short, baseline):
        return result
    progress(f"the same with {', '.join(size.key for size in collapsed)} near nominal")
    result = replace(result, collapsed=collapsed)
    credible = search_structures(near, baseline, progress)
    if not credible.complete:
        return replace(result, complete=False)
    if not credible.missing or not is_strongly_favoured(
        credible.final, _refit_like(near, result.final, credible.final)
    ):
        return result
    return replace(credible, collapsed=collapsed)


def _with_stated_sizes(
    data: Data,
    free: SearchResult,
    terms: Sequence[str],
    reference: Mapping[str, float],
    progress: Callable[[str], None],
) -> SearchResult:
    """Search again with the sizes of the user's model held, where the result contradicts these.

    A result that is as good with the stated sizes would be found again.
    """
    sizes = _sizes(data.model, reference)
    if not sizes or not _can_be_beaten(data, free.final, len(sizes)):
        return free
    held = replace(data, held=sizes)
    same = _hold_sizes(_like(held, free.final), free.final)
    if not is_strongly_favoured(free.final, same):
        return free
    progress("the same with the sizes of the given model held")
    baseline = fit_baseline(held, terms)
    result = search_structures(held, baseline, progress, others=[same], rival=free.final)
    return _likelier(data, free, result) if result.complete else replace(free, complete=False)


def _can_be_beaten(data: Data, free: Fitted, n_sizes: int) -> bool:
    """Whether one more term in the place of free sizes can be very strongly favoured.

    Where only noise is left, it can but save the parameters.
    """
    saved = (n_sizes - 1) * float(np.log(effective_samples(free)))
    return saved > -VERY_STRONG_DELTA_BIC or not leaves_only_noise(data, free)


def _hold_sizes(data: Data, fitted: Fitted) -> Fitted:
    """Refit with the sizes held at their values of ``data.begin``."""
    theta, places = fitted.theta.copy(), index_of(data.model.parameters)
    for place in (places[key] for key in data.held):
        theta[place] = data.begin[place]
    return refit(data, replace(fitted, theta=theta), fitted.terms, ())


def _refit_like(data: Data, fitted: Fitted, like: Fitted) -> Fitted:
    """Refit on the windows of another fit, ``like``."""
    return refit_on_windows(replace(_like(data, like), model=fitted.problem.model), fitted)


def _like(data: Data, fitted: Fitted) -> Data:
    """The data with the windows and the noise of a fit: fits are compared in the same units."""
    return replace(data, window=fitted.window, sigma=fitted.problem.sigma)


def _sizes(model: Model, reference: Mapping[str, float]) -> frozenset[str]:
    """Keys of the rig's own sizes that the user's model states."""
    return frozenset(p.key for p in model.parameters if p.term is None and p.key in reference)


def _likelier(data: Data, free: SearchResult, held: SearchResult) -> SearchResult:
    """Choose between the searches with free and with held sizes, by BIC on the same windows.

    Free sizes may absorb missing physics: a load at the flange changes many inertias. With held sizes missing
    physics may stand for a changed size, so that this result needs very strong evidence.
    """
    return held if is_strongly_favoured(held.final, _refit_like(data, free.final, held.final)) else free
