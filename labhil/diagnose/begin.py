"""What a diagnosis begins at: the data with their noise, and the baseline on the windows of the search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose.judge import Data
from labhil.ending import EndedEarly, accept
from labhil.identify.fitted import Fitted, fit_briefly, fit_by_continuation, start_theta
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.model import Model, Record

SEARCH_WINDOW_IN_HORIZONS = 0.375
FIRST_WINDOW_IN_HORIZONS = 0.1875

LASTS = 1.1
"""Factor by which noise as the baseline leaves it must differ from that of single samples to count."""


def data_of(
    model: Model, searched: Record, held_out: Record, reference: Mapping[str, float] | None = None
) -> Data:
    """What a search works on, its fits begun at ``reference`` where there is one."""
    searched, held_out = with_noise_scales(model, searched), with_noise_scales(model, held_out)
    window, begin = SEARCH_WINDOW_IN_HORIZONS * model.horizon, start_theta(model, reference)
    return Data(model, searched, held_out, noise_of(searched), noise_of(held_out), window, begin)


def baseline_of(data: Data, terms: Sequence[str]) -> tuple[Data, Fitted, bool]:
    """The data and the baseline in units of its noise, and whether that was ended early."""
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


def fit_baseline(data: Data, terms: Sequence[str]) -> Fitted:
    """The baseline on the windows of the search, by way of shorter ones."""
    lengths = [FIRST_WINDOW_IN_HORIZONS * data.model.horizon, data.window]
    model, record, sigma, begin = data.model, data.search, data.sigma, data.begin
    return fit_by_continuation(
        model, record, terms, lengths, sigma, start=begin, new_terms=terms, held=data.held
    )[-1]


def with_coloured_noise(data: Data, base: Fitted) -> tuple[Data, Fitted]:
    """The data with noise as the baseline leaves it on short windows, and the baseline in units of that."""
    search_sigma = estimate_coloured_noise(data.model, base.theta, data.search, data.sigma).sigma
    test_sigma = estimate_coloured_noise(data.model, base.theta, data.test, data.test_sigma).sigma
    if np.all((search_sigma < LASTS * data.sigma) & (LASTS * search_sigma > data.sigma)):
        return replace(data, test_sigma=test_sigma), base
    data = replace(data, sigma=search_sigma, test_sigma=test_sigma)
    return data, fit_baseline(replace(data, begin=base.theta), base.terms)
