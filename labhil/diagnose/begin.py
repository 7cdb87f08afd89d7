"""The start of a diagnosis: data in units of their noise, and the fitted baseline.

``diagnosis.py`` calls these functions before ``structures/stages.py`` searches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose.judge import Data
from labhil.ending import EndedEarly, accept
from labhil.identify.fitted import Fitted, fit_briefly, fit_by_continuation, start_theta
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.model import Model
from labhil.physics.record import Record


def prepare_data(
    model: Model,
    searched: Record,
    held_out: Record,
    reference: Mapping[str, float] | None = None,
    *,
    window_in_horizons: float = 0.375,
) -> Data:
    """Estimate the noise of both data sets and set the windows of the search.

    Args:
        model: the model.
        searched: recordings that the search works on.
        held_out: recordings that it is tested on.
        reference: values by parameter key at which fits start; others start at their nominal values.
        window_in_horizons: length of the windows, in horizons of the metric.

    Returns:
        The data of the search.
    """
    searched, held_out = with_noise_scales(model, searched), with_noise_scales(model, held_out)
    window, begin = window_in_horizons * model.horizon, start_theta(model, reference)
    return Data(model, searched, held_out, noise_of(searched), noise_of(held_out), window, begin)


def fit_baseline_and_noise(data: Data, terms: Sequence[str]) -> tuple[Data, Fitted, bool]:
    """Fit the baseline, estimate coloured noise beside it, and refit where that noise differs.

    Args:
        data: the data of the search.
        terms: keys of the baseline's terms.

    Returns:
        The data with their noise, the baseline, and whether the user ended the fit early (the baseline is
        then fitted only briefly).
    """
    base: Fitted | None = None
    try:
        base = fit_baseline(data, terms)
        return *with_coloured_noise(data, base), False
    except EndedEarly:
        accept()
    if base is None:
        window, begin = data.window, data.begin
        base = fit_briefly(data.model, data.search, terms, window, data.sigma, begin, from_own_starts=True)
    return data, base, True


def fit_baseline(data: Data, terms: Sequence[str], *, first_window_in_horizons: float = 0.1875) -> Fitted:
    """Fit the baseline on the windows of the search, after a fit on shorter windows.

    Args:
        data: the data of the search.
        terms: keys of the baseline's terms.
        first_window_in_horizons: length of the shorter windows, half of the search's by default.

    Returns:
        The fit on the windows of the search.
    """
    lengths = [first_window_in_horizons * data.model.horizon, data.window]
    model, record, sigma, begin = data.model, data.search, data.sigma, data.begin
    return fit_by_continuation(
        model, record, terms, lengths, sigma, start=begin, new_terms=terms, held=data.held
    )[-1]


def with_coloured_noise(data: Data, base: Fitted, *, min_noise_ratio: float = 1.1) -> tuple[Data, Fitted]:
    """Replace the noise of the data by coloured noise estimated beside the baseline.

    Args:
        data: the data of the search.
        base: the baseline fitted with the noise of the data.
        min_noise_ratio: ratio of both noise estimates, either way, from which the baseline is refitted.

    Returns:
        The data with their noise, and the baseline in units of that.
    """
    search_sigma = estimate_coloured_noise(data.model, base.theta, data.search, data.sigma).sigma
    test_sigma = estimate_coloured_noise(data.model, base.theta, data.test, data.test_sigma).sigma
    if np.all((search_sigma < min_noise_ratio * data.sigma) & (min_noise_ratio * search_sigma > data.sigma)):
        return replace(data, test_sigma=test_sigma), base
    data = replace(data, sigma=search_sigma, test_sigma=test_sigma)
    return data, fit_baseline(replace(data, begin=base.theta), base.terms)
