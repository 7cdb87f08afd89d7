"""What only a held-out recording shows: the search goes on with parts of it.

A recording may never come where an effect acts (too slow, too small a stroke), while another one does. The
other parts of that other one then are what the search never sees.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from labhil.diagnose.found import Step
from labhil.diagnose.judge import Data
from labhil.identify.windows import told_apart
from labhil.physics.model import Record, joined

PARTS = (4, 2)
"""Into how many the held-out recording is cut, if they are long enough: an effect may act now and then."""

ELSEWHERE = 0.1
"""Share of the held-out samples beyond all that was searched from which that other one goes elsewhere."""

BEYOND_DOUBT = -50.0
"""ΔBIC that what more data add has to have: what is left of a real rig passes for evidence more easily."""

LONG_ENOUGH = 1.25
"""Horizons in each, at least: half of one before what is scored."""


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
            return told_apart(data.model, searched), told_apart(data.model, kept)
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
