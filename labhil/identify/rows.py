"""Rows of windows that lie after each other: what every step of a fit does to them, in one pass."""

from __future__ import annotations

import numpy as np

from labhil.compiled import compiled
from labhil.signals import FloatArray, IntArray


@compiled
def over_noise(simulated: FloatArray, measured: FloatArray, noise: FloatArray, worst: float) -> FloatArray:
    """(simulated − measured) / noise, all (N, c): (N·c,) within ±``worst`` (which no number is, too)."""
    n, channels = simulated.shape
    out = np.empty(n * channels)
    for k in range(n):
        for c in range(channels):
            found = (simulated[k, c] - measured[k, c]) / noise[k, c]
            out[k * channels + c] = worst if np.isnan(found) else min(max(found, -worst), worst)
    return out


@compiled
def products(edges: IntArray, left: FloatArray, right: FloatArray) -> FloatArray:
    """LᵀR of each window's rows (W, S, k) for (n, S) and (n, k); window w begins at row ``edges[w]``."""
    n, wide, high = left.shape[0], left.shape[1], right.shape[1]
    out = np.zeros((edges.size, wide, high))
    for w in range(edges.size):
        for k in range(edges[w], edges[w + 1] if w + 1 < edges.size else n):
            for i in range(wide):
                for j in range(high):
                    out[w, i, j] += left[k, i] * right[k, j]
    return out


@compiled
def without(edges: IntArray, columns: FloatArray, slopes: FloatArray, share: FloatArray) -> FloatArray:
    """Columns (n, k) less slopes (n, S) times each window's ``share`` (W, S, k) of them."""
    n, wide, high = columns.shape[0], slopes.shape[1], columns.shape[1]
    out = columns.copy()
    for w in range(edges.size):
        for k in range(edges[w], edges[w + 1] if w + 1 < edges.size else n):
            for i in range(wide):
                for j in range(high):
                    out[k, j] -= slopes[k, i] * share[w, i, j]
    return out
