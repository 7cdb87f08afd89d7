"""Inner products within windows, against numpy's on each window by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labhil.identify.window_products import window_products, without_states

LENGTHS = st.lists(st.integers(1, 30), min_size=1, max_size=6)


def columns(rows: int, count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((rows, count))


@settings(deadline=None)  # kernels are compiled
@given(LENGTHS, st.integers(0, 4), st.integers(0, 7), st.booleans())
def test_products_of_each_window(lengths, states, count, by_columns):
    ends = np.cumsum(lengths)
    left, right = columns(ends[-1], states, 1), columns(ends[-1], count, 2)
    if by_columns:
        left, right = np.asfortranarray(left), np.asfortranarray(right)
    found = window_products(left, right, ends - lengths)
    for w, (first, last) in enumerate(zip(ends - lengths, ends, strict=True)):
        np.testing.assert_allclose(found[w], left[first:last].T @ right[first:last], atol=1e-12)


@settings(deadline=None)  # kernels are compiled
@given(LENGTHS, st.integers(1, 4), st.integers(1, 7))
def test_what_states_explain_is_orthogonal_to_what_is_left(lengths, states, count):
    lengths = [length + states for length in lengths]
    ends = np.cumsum(lengths)
    edges = ends - lengths
    by_states, of = columns(ends[-1], states, 3), columns(ends[-1], count, 4)
    share = np.linalg.solve(
        window_products(by_states, by_states, edges), window_products(by_states, of, edges)
    )
    given_columns = of.copy()
    left = without_states(of, by_states, share, edges)
    for first, last in zip(edges, ends, strict=True):
        best = np.linalg.lstsq(by_states[first:last], of[first:last], rcond=None)[0]
        assert left[first:last] == pytest.approx(of[first:last] - by_states[first:last] @ best, abs=1e-6)
    np.testing.assert_array_equal(of, given_columns)
