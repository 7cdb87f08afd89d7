"""Augmented search: search again with parts of the held-out recording, where only that shows an effect.

The searched recording may never reach the region where an effect acts (too slow, too small a stroke) while
the held-out one does. The search then gets every other part of the held-out recording and is tested on the
parts between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from labhil.diagnose.adequacy import exceeds_noise, residual_rms
from labhil.diagnose.begin import fit_baseline, with_coloured_noise
from labhil.diagnose.judge import Data, is_strongly_favoured
from labhil.diagnose.refit import refit_on_windows
from labhil.diagnose.search_result import SearchResult, Step
from labhil.diagnose.structures.enumerate import MIN_RELEVANCE, relevance
from labhil.identify.fitted import Fitted
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.score import Score, score
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.joining import join_records
from labhil.physics.record import Record
from labhil.signals import FloatArray


def augmented_search(
    data: Data,
    result: SearchResult,
    search: Callable[[Data, Fitted], SearchResult],
    progress: Callable[[str], None],
) -> tuple[Data, SearchResult, FloatArray]:
    """Search again with half of the held-out data where these show an unexplained effect.

    The terms of the second search replace the first ones if they explain the augmented data or, where these
    leave the searched range, if they include the first ones and more; where the first search names nothing,
    if they leave less. If the second search names nothing, the first terms are dropped unless very strong
    evidence on the augmented data supports them.

    Args:
        data: the data of the first search.
        result: its result.
        search: searches data beside a fitted baseline.
        progress: is called with a line of text at each stage.

    Returns:
        Data and result of the search that counts, and the RMS of its final residuals in units of the noise,
        (2, c).
    """
    rms = residual_rms(data, result.final)
    parts = split_held_out(data) if _has_unexplained_error(data, result, rms) else None
    if parts is None:
        return data, result, rms
    progress("the held-out data show something else: the search goes on with half of them")
    searched, judged = parts
    sigma, test_sigma = noise_of(searched), noise_of(judged)
    more = replace(data, search=searched, test=judged, sigma=sigma, test_sigma=test_sigma)
    more, base = with_coloured_noise(more, fit_baseline(more, result.baseline.terms))
    second = search(more, base)
    if not second.complete:
        return data, replace(result, complete=False), rms
    second_rms = residual_rms(more, second.final)
    if second.missing:
        adds_terms = leaves_searched_range(data) and adds_certain_terms(result.missing, second.missing)
        improves = not result.missing and bool(np.max(second_rms) < np.max(rms))
        replaces_first = adds_terms or improves or not exceeds_noise(more, second_rms)
    else:
        replaces_first = bool(np.max(second_rms) < np.max(rms)) and not _supports_first_terms(
            more, result, second
        )
    return (more, second, second_rms) if replaces_first else (data, result, rms)


def _has_unexplained_error(
    data: Data, result: SearchResult, rms: FloatArray, *, max_excess: float = 1.1
) -> bool:
    """Whether held-out data show an error that neither named terms nor a curve nor the search data explain.

    Where the search names nothing, a held-out RMSE over the noise floor above ``max_excess`` suffices: terms
    that only the held-out data rejected are tested again on more data.
    """
    if result.curve is not None or (result.missing and not exceeds_search_residuals(rms)):
        return False
    return exceeds_noise(data, rms[1]) or _held_out_score(data, result).excess > max_excess


def exceeds_search_residuals(rms: FloatArray) -> bool:
    """Decide whether the residuals of some output are much larger on held-out than on search data.

    The first search had the residuals of the search data: residuals of the same size add no information.

    Args:
        rms: RMS of residuals on search and held-out data, (2, c), in units of the noise.

    Returns:
        True if they are.
    """
    outputs = np.eye(rms.shape[1], dtype=bool)
    return max(relevance(rms[1] ** 2, rms[0] ** 2, output) for output in outputs) >= MIN_RELEVANCE


def split_held_out(
    data: Data, *, part_counts: Sequence[int] = (4, 2), min_part_in_horizons: float = 1.25
) -> tuple[Record, Record] | None:
    """Add every other part of the held-out recording to the searched one.

    Args:
        data: the data of the first search.
        part_counts: numbers of parts to cut into, in order of preference: more parts are likelier to share
            an effect that acts only sometimes.
        min_part_in_horizons: shortest part, in horizons of the metric; half a horizon is lead-in.

    Returns:
        The augmented search recording and the remaining parts; None of several recordings, where parameters
        may belong to one of them, of inverse dynamics, where a recording cannot be cut, and where the parts
        would be too short.
    """
    if len(data.search.begins) + len(data.test.begins) > 2 or not data.model.state_names:
        return None
    for count in part_counts:
        if data.test.duration / count >= min_part_in_horizons * data.model.horizon:
            edges = np.linspace(0, len(data.test), count + 1).astype(int)
            parts = [data.test.part(int(a), int(b)) for a, b in pairwise(edges)]
            searched, judged = join_records([data.search, *parts[::2]]), join_records(parts[1::2])
            return with_noise_scales(data.model, searched), with_noise_scales(data.model, judged)
    return None


def leaves_searched_range(data: Data, *, min_share_outside: float = 0.1) -> bool:
    """Decide whether an output of the held-out data often lies outside the range of the search data.

    An example is a motor that turns one way only in the search data, and both ways in the held-out data.

    Args:
        data: the data of the first search.
        min_share_outside: share of the held-out samples outside the range, from which the answer is True.

    Returns:
        True if the share is exceeded for some output.
    """
    low, high = data.search.outputs.min(axis=0), data.search.outputs.max(axis=0)
    beyond = (data.test.outputs < low - data.sigma) | (data.test.outputs > high + data.sigma)
    return bool(np.any(beyond.mean(axis=0) > min_share_outside))


def adds_certain_terms(
    first: Sequence[Step], second: Sequence[Step], *, max_delta_bic: float = -50.0
) -> bool:
    """Decide whether a second search names all terms of the first and more, with overwhelming evidence.

    No model of a real rig explains everything, so that residuals other than noise do not speak against the
    added terms; but such residuals pass for evidence more easily, which raises the limit.

    Args:
        first: named terms of the first search.
        second: named terms of the second search.
        max_delta_bic: ΔBIC below which each added term has to be.

    Returns:
        True if all first terms are kept and all added ones certain.
    """
    named = {step.terms[0] for step in first}
    added = [step for step in second if step.terms[0] not in named]
    keeps_first = named <= {step.terms[0] for step in second}
    return bool(named and added) and keeps_first and all(s.evidence.delta_bic < max_delta_bic for s in added)


def _supports_first_terms(more: Data, result: SearchResult, second: SearchResult) -> bool:
    """Whether very strong evidence on the augmented data favours the terms of the first search.

    A baseline that is refitted to half of the held-out data may leave no visible error in the other half.
    """
    if not result.missing:
        return False
    return is_strongly_favoured(
        refit_on_windows(replace(more, window=second.final.window), result.final), second.final
    )


def _held_out_score(data: Data, result: SearchResult) -> Score:
    """Score of a result on the held-out data, on the metric's windows."""
    theta = result.final.theta
    noise = estimate_coloured_noise(data.model, theta, data.test, noise_of(data.test))
    return score(data.model, theta, data.test, noise.sigma, variance_inflation=noise.variance_inflation)
