"""What only a held-out recording shows: the search goes on with parts of it.

A recording may never come where an effect acts (too slow, too small a stroke), while another one does. The
other parts of that other one then are what the search never sees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from labhil.diagnose.adequacy import residual_rms, unexplained
from labhil.diagnose.begin import fit_baseline, with_coloured_noise
from labhil.diagnose.judge import Data, far_likelier
from labhil.diagnose.refit import on_windows
from labhil.diagnose.search_result import SearchResult, Step
from labhil.identify.fitted import Fitted
from labhil.identify.noise import estimate_coloured_noise
from labhil.identify.score import Score, score
from labhil.identify.windows import noise_of, with_noise_scales
from labhil.physics.model import Record, joined
from labhil.signals import FloatArray

PARTS = (4, 2)
"""Into how many the held-out recording is cut, if they are long enough: an effect may act now and then."""

ELSEWHERE = 0.1
"""Share of the held-out samples beyond all that was searched from which that other one goes elsewhere."""

BEYOND_DOUBT = -50.0
"""ΔBIC that what more data add has to have: what is left of a real rig passes for evidence more easily."""

SHOWN = 1.1
"""RMSE over the noise floor, on held-out data, that asks for a wider search."""

LONG_ENOUGH = 1.25
"""Horizons in each, at least: half of one before what is scored."""


def augmented_search(
    data: Data,
    found: SearchResult,
    look: Callable[[Data, Fitted], SearchResult],
    progress: Callable[[str], None],
) -> tuple[Data, SearchResult, FloatArray]:
    """Data, what was found, and what that leaves: of a wider search where held-out data show something else.

    What that names has to explain them, or to be more than was named first, of data that go elsewhere; else
    the first answer stays. Where it names nothing, what was named first does not hold on more data, unless
    these still ask for it.
    """
    left = residual_rms(data, found.final)
    explained = found.curve is not None
    shown = not explained and (unexplained(data, left[1]) or _marked(data, found).excess > SHOWN)
    parts = searched_and_kept(data) if shown else None
    if parts is None:
        return data, found, left
    progress("the held-out data show something else: the search goes on with half of them")
    searched, kept = parts
    sigma, test_sigma = noise_of(searched), noise_of(kept)
    wider = replace(data, search=searched, test=kept, sigma=sigma, test_sigma=test_sigma)
    wider, base = with_coloured_noise(wider, fit_baseline(wider, found.baseline.terms))
    again = look(wider, base)
    if not again.complete:
        return data, replace(found, complete=False), left
    left_then = residual_rms(wider, again.final)
    if again.missing:
        more = goes_elsewhere(data) and adds_beyond_doubt(found.missing, again.missing)
        firm = more or not unexplained(wider, left_then)
    else:
        firm = bool(np.max(left_then) < np.max(left)) and not _still_needed(wider, found, again)
    return (wider, again, left_then) if firm else (data, found, left)


def searched_and_kept(data: Data) -> tuple[Record, Record] | None:
    """What was searched with every other part of the held-out recording, and the parts that are left.

    None of several recordings, where parameters may belong to one of them, where a record cannot be cut
    (inverse dynamics) and where parts would be too short to judge on.
    """
    if len(data.search.begins) + len(data.test.begins) > 2 or not data.model.state_names:
        return None
    for count in PARTS:
        if data.test.duration / count >= LONG_ENOUGH * data.model.horizon:
            edges = np.linspace(0, len(data.test), count + 1).astype(int)
            parts = [data.test.part(int(a), int(b)) for a, b in pairwise(edges)]
            searched, kept = joined([data.search, *parts[::2]]), joined(parts[1::2])
            return with_noise_scales(data.model, searched), with_noise_scales(data.model, kept)
    return None


def goes_elsewhere(data: Data) -> bool:
    """Whether an output of the held-out data often lies beyond all values that were searched.

    A motor that turned one way only while it was searched turns the other way, too.
    """
    low, high = data.search.outputs.min(axis=0), data.search.outputs.max(axis=0)
    beyond = (data.test.outputs < low - data.sigma) | (data.test.outputs > high + data.sigma)
    return bool(np.any(beyond.mean(axis=0) > ELSEWHERE))


def adds_beyond_doubt(first: Sequence[Step], then: Sequence[Step]) -> bool:
    """Whether a wider search names all that was named ``first``, and more, each of these beyond doubt.

    No model of a real rig explains all: what more data add to it is no worse for that. But what is left is
    no noise then, and passes for evidence more easily.
    """
    named = {step.terms[0] for step in first}
    added = [step for step in then if step.terms[0] not in named]
    kept = named <= {step.terms[0] for step in then}
    return bool(named and added) and kept and all(s.evidence.delta_bic < BEYOND_DOUBT for s in added)


def _still_needed(wider: Data, found: SearchResult, again: SearchResult) -> bool:
    """Whether what was named first explains more data than it was found on by very strong evidence.

    A baseline that is refitted to half of the held-out data may leave nothing to be seen in the other half.
    """
    if not found.missing:
        return False
    return far_likelier(on_windows(replace(wider, window=again.final.window), found.final), again.final)


def _marked(data: Data, found: SearchResult) -> Score:
    """How well what was found foretells the held-out data, on the metric's windows."""
    theta = found.final.theta
    noise = estimate_coloured_noise(data.model, theta, data.test, noise_of(data.test))
    return score(data.model, theta, data.test, noise.sigma, lasts=noise.lasts)
