"""Compiled kernels of least squares with one initial state per window: inner products and projections.

A fit calls them thousands of times, with some ten thousand rows and a few columns. They pass once over the
rows and allocate only the result. The solver that uses them is in problem.py and least_squares.py.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import compiled
from labhil.signals import FloatArray, IntArray


def window_products(left: FloatArray, right: FloatArray, edges: IntArray) -> FloatArray:
    """Take inner products of columns within each window.

    Args:
        left: (N, S).
        right: (N, K).
        edges: (W,), first rows of the consecutive windows.

    Returns:
        Σ left[n, s]·right[n, k] over the rows of each window, (W, S, K).

    Example:
        >>> ones = np.ones((5, 1))
        >>> window_products(ones, np.arange(5.0)[:, None], np.array([0, 2])).ravel().tolist()
        [1.0, 9.0]
    """
    out = np.zeros((len(edges), left.shape[1], right.shape[1]))
    _sum_products(np.ascontiguousarray(left), np.ascontiguousarray(right), edges, out)
    return out


def without_states(
    columns: FloatArray, by_states: FloatArray, share: FloatArray, edges: IntArray
) -> FloatArray:
    """Subtract the contribution of each window's initial state from columns.

    Args:
        columns: (N, K).
        by_states: (N, S), slopes by the initial state of the row's window.
        share: (W, S, K), coefficients of each window's state.
        edges: (W,), first rows of the consecutive windows.

    Returns:
        columns[n, k] − Σ by_states[n, s]·share[w, s, k] with the window w of row n, (N, K).

    Example:
        >>> without_states(np.ones((2, 1)), np.ones((2, 1)), np.full((1, 1, 1), 0.25), np.array([0])).ravel()
        array([0.75, 0.75])
    """
    out = np.array(columns, dtype=np.float64, order="C")
    _subtract_states(np.ascontiguousarray(by_states), np.ascontiguousarray(share), edges, out)
    return out


@compiled
def _sum_products(left: FloatArray, right: FloatArray, edges: IntArray, out: FloatArray) -> None:
    for w in range(edges.size):
        last = edges[w + 1] if w + 1 < edges.size else left.shape[0]
        for n in range(edges[w], last):
            for s in range(left.shape[1]):
                for k in range(right.shape[1]):
                    out[w, s, k] += left[n, s] * right[n, k]


@compiled
def _subtract_states(by_states: FloatArray, share: FloatArray, edges: IntArray, out: FloatArray) -> None:
    for w in range(edges.size):
        last = edges[w + 1] if w + 1 < edges.size else out.shape[0]
        for n in range(edges[w], last):
            for s in range(by_states.shape[1]):
                for k in range(out.shape[1]):
                    out[n, k] -= by_states[n, s] * share[w, s, k]
