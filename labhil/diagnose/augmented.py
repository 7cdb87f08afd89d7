"""What only a held-out recording shows: the search goes on with parts of it.

The searched recording may never reach where an effect acts (too slow, too small a stroke) while the held-out
one does. The search then takes every other part of that; the parts between stay unseen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from labhil.diagnose.adequacy import exceeds_noise, residual_rms
from labhil.diagnose.begin import fit_baseline, with_coloured_noise
from labhil.diagnose.judge import Data, is_far_likelier
from labhil.diagnose.refit import on_windows
from labhil.diagnose.search_result import SearchResult, Step
from labhil.diagnose.structures.enumerate import MIN_RELEVANCE, relevance
from labhil.identify.fitted import Fitted
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.score import Score, score
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.joining import join_records
from labhil.physics.model import Record
from labhil.signals import FloatArray

PARTS = (4, 2)
"""Into how many the held-out recording is cut, if they are long enough: an effect may act now and then."""

ELSEWHERE = 0.1
"""Share of the held-out samples outside the searched range from which the held-out data go elsewhere."""

BEYOND_DOUBT = -50.0
"""ΔBIC that a term needs which more data add: residuals of a real rig pass for evidence more easily."""

SHOWN = 1.1
"""RMSE over the noise floor, on held-out data, that asks for a wider search."""

LONG_ENOUGH = 1.25
"""Horizons in each, at least: half of one before what is scored."""


def augmented_search(
    data: Data,
    result: SearchResult,
    search: Callable[[Data, Fitted], SearchResult],
    progress: Callable[[str], None],
) -> tuple[Data, SearchResult, FloatArray]:
    """Data, result and the RMS that it leaves: of a wider search where held-out data show something else.

    The terms of the wider search have to explain these data or, where they go elsewhere, to be more than the
    first ones; else the first result stays. Where the wider search names nothing, the first terms do not hold
    on more data, unless these still need them.
    """
    rms = residual_rms(data, result.final)
    parts = split_held_out(data) if _shows_something_else(data, result, rms) else None
    if parts is None:
        return data, result, rms
    progress("the held-out data show something else: the search goes on with half of them")
    searched, judged = parts
    sigma, test_sigma = noise_of(searched), noise_of(judged)
    wider = replace(data, search=searched, test=judged, sigma=sigma, test_sigma=test_sigma)
    wider, base = with_coloured_noise(wider, fit_baseline(wider, result.baseline.terms))
    wider_result = search(wider, base)
    if not wider_result.complete:
        return data, replace(result, complete=False), rms
    wider_rms = residual_rms(wider, wider_result.final)
    if wider_result.missing:
        more = goes_elsewhere(data) and adds_beyond_doubt(result.missing, wider_result.missing)
        firm = more or not exceeds_noise(wider, wider_rms)
    else:
        firm = bool(np.max(wider_rms) < np.max(rms)) and not _needs_first_terms(wider, result, wider_result)
    return (wider, wider_result, wider_rms) if firm else (data, result, rms)


def _shows_something_else(data: Data, result: SearchResult, rms: FloatArray) -> bool:
    """Whether the held-out data show what neither terms nor a curve nor the searched data account for.

    Terms that only the held-out data did not bear out get a second chance on more data in any case.
    """
    if result.curve is not None or (result.missing and not leave_more(rms)):
        return False
    return exceeds_noise(data, rms[1]) or _held_out_score(data, result).excess > SHOWN


def leave_more(rms: FloatArray) -> bool:
    """Whether held-out data leave more of some output than the searched ones leave beyond the noise.

    The search has had the residuals of the searched data before it: as much again tells it nothing.

    Args:
        rms: (2, c) left of searched and held-out data, in units of the noise.
    """
    each = np.eye(rms.shape[1], dtype=bool)
    return max(relevance(rms[1] ** 2, rms[0] ** 2, one) for one in each) >= MIN_RELEVANCE


def split_held_out(data: Data) -> tuple[Record, Record] | None:
    """The searched recording with every other part of the held-out one, and the parts between.

    None of several recordings, where parameters may belong to one of them, where a record cannot be cut
    (inverse dynamics) and where parts would be too short to judge on.
    """
    if len(data.search.begins) + len(data.test.begins) > 2 or not data.model.state_names:
        return None
    for count in PARTS:
        if data.test.duration / count >= LONG_ENOUGH * data.model.horizon:
            edges = np.linspace(0, len(data.test), count + 1).astype(int)
            parts = [data.test.part(int(a), int(b)) for a, b in pairwise(edges)]
            searched, judged = join_records([data.search, *parts[::2]]), join_records(parts[1::2])
            return with_noise_scales(data.model, searched), with_noise_scales(data.model, judged)
    return None


def goes_elsewhere(data: Data) -> bool:
    """Whether an output of the held-out data often lies beyond all values that were searched.

    A motor that turned one way only while it was searched turns the other way, too.
    """
    low, high = data.search.outputs.min(axis=0), data.search.outputs.max(axis=0)
    beyond = (data.test.outputs < low - data.sigma) | (data.test.outputs > high + data.sigma)
    return bool(np.any(beyond.mean(axis=0) > ELSEWHERE))


def adds_beyond_doubt(first: Sequence[Step], then: Sequence[Step]) -> bool:
    """Whether a wider search names all ``first`` terms and more, each of the added ones beyond doubt.

    No model of a real rig explains everything, and terms that more data add are no worse for that. But what
    is left then is no noise, and passes for evidence more easily.
    """
    named = {step.terms[0] for step in first}
    added = [step for step in then if step.terms[0] not in named]
    keeps_first = named <= {step.terms[0] for step in then}
    return bool(named and added) and keeps_first and all(s.evidence.delta_bic < BEYOND_DOUBT for s in added)


def _needs_first_terms(wider: Data, result: SearchResult, wider_result: SearchResult) -> bool:
    """Whether very strong evidence on the wider data favours the terms that were named first.

    A baseline that is refitted to half of the held-out data may leave nothing to be seen in the other half.
    """
    if not result.missing:
        return False
    return is_far_likelier(
        on_windows(replace(wider, window=wider_result.final.window), result.final), wider_result.final
    )


def _held_out_score(data: Data, result: SearchResult) -> Score:
    """How well a result predicts the held-out data, on the metric's windows."""
    theta = result.final.theta
    noise = estimate_coloured_noise(data.model, theta, data.test, noise_of(data.test))
    return score(data.model, theta, data.test, noise.sigma, variance_inflation=noise.variance_inflation)
