"""Augmented search: when terms of a search with held-out data replace those of the first search."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.diagnose.augmented import adds_certain_terms, exceeds_search_residuals, leaves_searched_range
from labhil.diagnose.begin import prepare_data
from labhil.diagnose.evidence import Evidence
from labhil.diagnose.search_result import Step
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.rig import default_rig


def turning(speeds, seed):
    """A motor's record with these speeds (rad/s), read with noise."""
    read = np.asarray(speeds) + 0.01 * np.random.default_rng(seed).standard_normal(len(speeds))
    t = 0.01 * np.arange(len(speeds))
    return Record(t, np.asarray(speeds)[:, None], read[:, None], ("voltage",), ("speed",), ("rad/s",))


@pytest.mark.parametrize(
    ("largest", "outside"),
    [(5.0, False), (5.0 + 1e-3, False), (5.5, True), (-5.0, True)],
)
def test_held_out_data_that_often_lie_outside_leave_the_searched_range(largest, outside):
    swing = 0.5 * (1.0 - np.cos(np.linspace(0.0, 12.0 * np.pi, 1000)))
    searched, held_out = turning(5.0 * swing, 1), turning(largest * swing, 2)
    model = model_for(default_rig("dc_motor"), searched)
    assert leaves_searched_range(prepare_data(model, searched, held_out)) == outside


def test_single_readings_outside_do_not_leave_the_searched_range():
    swing = 0.5 * (1.0 - np.cos(np.linspace(0.0, 12.0 * np.pi, 1000)))
    further = 5.0 * swing
    further[500:550] += 3.0
    model = model_for(default_rig("dc_motor"), turning(swing, 1))
    assert not leaves_searched_range(prepare_data(model, turning(5.0 * swing, 1), turning(further, 2)))


def steps(**delta_bics):
    return [Step((term,), Evidence(delta, 1e-4, 9.0), 1e-6, True) for term, delta in delta_bics.items()]


@pytest.mark.parametrize(
    ("first", "then", "added"),
    [
        (steps(time_delay=-34.0), steps(time_delay=-60.0, spring_force=-353.0), True),
        (steps(time_delay=-34.0), steps(time_delay=-60.0, spring_force=-31.0), False),
        (steps(time_delay=-34.0), steps(time_delay=-60.0, spring_force=-353.0, sensor_offset=-20.0), False),
        (steps(time_delay=-34.0), steps(spring_force=-353.0), False),
        (steps(time_delay=-34.0), steps(time_delay=-60.0), False),
        ([], steps(spring_force=-353.0), False),
    ],
)
def test_terms_are_added_with_overwhelming_evidence_only(first, then, added):
    """Where more than noise remains, merely strong evidence may stem from other errors."""
    assert adds_certain_terms(first, then) == added


@pytest.mark.parametrize(
    ("searched", "held_out", "more"),
    [
        ([1.0], [1.3], True),  # noise was left, and more than noise is
        ([1.3], [1.5], True),
        ([5100.0], [6500.0], False),  # as a real rig leaves more in one part than in another
        ([5100.0], [8000.0], True),
        ([5100.0], [5.0], False),
        ([300.0, 1.0], [310.0, 1.6], True),  # of the second output
    ],
)
def test_held_out_residuals_count_where_they_exceed_those_of_the_search(searched, held_out, more):
    assert exceeds_search_residuals(np.array([searched, held_out])) == more
