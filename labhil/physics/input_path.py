"""Effects between the command and the mechanism, shared by every rig; all act on sampled angles or volts.

Each walks once through the whole recording, so that what it remembers (a gap's side, a lag's state)
comes from the whole past and not from the start of a window. Each returns a new array.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import compiled
from labhil.signals import FloatArray


@compiled
def backlash(u: FloatArray, gap: float) -> FloatArray:
    """Play operator of full width ``gap`` (unit of u); begins in the middle of its play."""
    y = np.empty_like(u)
    half = 0.5 * gap
    output = u[0]
    for i in range(u.size):
        output = min(max(output, u[i] - half), u[i] + half)
        y[i] = output
    return y


@compiled
def dead_zone(u: FloatArray, left: float, right: float) -> FloatArray:
    """No output between −left and right, shifted beyond (eq. 4.18 of the reference text)."""
    y = np.zeros_like(u)
    for i in range(u.size):
        if u[i] >= right:
            y[i] = u[i] - right
        elif u[i] <= -left:
            y[i] = u[i] + left
    return y


@compiled
def saturation(u: FloatArray, inverse_limit: float) -> FloatArray:
    """Clip to ±1/inverse_limit; zero means no limit."""
    if inverse_limit <= 0.0:
        return u.copy()
    limit = 1.0 / inverse_limit
    return np.minimum(np.maximum(u, -limit), limit)


@compiled
def rate_limit(t: FloatArray, u: FloatArray, inverse_rate: float) -> FloatArray:
    """Follow u no faster than 1/inverse_rate per second; zero means as fast as it likes."""
    y = u.copy()
    if inverse_rate <= 0.0:
        return y
    for i in range(1, u.size):
        step = (t[i] - t[i - 1]) / inverse_rate
        y[i] = min(max(u[i], y[i - 1] - step), y[i - 1] + step)
    return y


@compiled
def first_order_lag(t: FloatArray, u: FloatArray, time_constant: float) -> FloatArray:
    """Solve T·ẏ + y = u exactly for u that is straight between samples; begins settled at u[0]."""
    y = u.copy()
    if time_constant <= 0.0:
        return y
    for i in range(1, u.size):
        h = t[i] - t[i - 1]
        slope = (u[i] - u[i - 1]) / h
        decay = np.exp(-h / time_constant)
        y[i] = u[i] - slope * time_constant + (y[i - 1] - u[i - 1] + slope * time_constant) * decay
    return y
