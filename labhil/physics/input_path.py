"""Effects of the input path, from the command to the mechanism: backlash, dead zone, saturation, limits, lag.

A signal is given by nodes, linear in between: times ``t`` (n,), s, and values ``u`` (n,). Each effect returns
new nodes and adds one wherever it bends the signal between two samples, so results do not depend on the
sampling. Each is applied once to the whole recording, so its memory (the side of a gap, the state of a lag)
comes from the whole past and not from the start of a window. ``physics.driven`` applies them in order.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import inlined
from labhil.signals import FloatArray, IntArray

Nodes = tuple[FloatArray, FloatArray]
"""Times and values of a piecewise linear signal."""


@inlined
def with_crossings(t: FloatArray, u: FloatArray, low: float, high: float) -> Nodes:
    """Add nodes where the signal crosses the levels ``low`` and ``high``."""
    times, values = np.empty(3 * t.size), np.empty(3 * t.size)
    count = 0
    for i in range(t.size):
        if i > 0:
            up = u[i] > u[i - 1]
            for j in range(2):
                level = (low if j == 0 else high) if up else (high if j == 0 else low)
                if (u[i - 1] - level) * (u[i] - level) < 0.0:
                    share = (level - u[i - 1]) / (u[i] - u[i - 1])
                    times[count], values[count] = t[i - 1] + share * (t[i] - t[i - 1]), level
                    count += 1
        times[count], values[count] = t[i], u[i]
        count += 1
    return times[:count], values[:count]


@inlined
def dead_zone(t: FloatArray, u: FloatArray, left: float, right: float) -> Nodes:
    """Dead zone: y = u − right above right, u + left below −left, else 0 (eq. 4.18 of the reference text)."""
    t, u = with_crossings(t, u, -left, right)
    return t, np.maximum(u - right, 0.0) + np.minimum(u + left, 0.0)


@inlined
def saturation(t: FloatArray, u: FloatArray, inverse_limit: float) -> Nodes:
    """Saturation: clip to ±1/inverse_limit; zero means no limit."""
    if inverse_limit <= 0.0:
        return t, u
    limit = 1.0 / inverse_limit
    t, u = with_crossings(t, u, -limit, limit)
    return t, np.minimum(np.maximum(u, -limit), limit)


@inlined
def backlash(t: FloatArray, u: FloatArray, gap: float) -> Nodes:
    """Backlash: play operator of width ``gap`` (unit of u; Prandtl 1928), initially in mid-gap."""
    times, values = np.empty(2 * t.size), np.empty(2 * t.size)
    half, output, count = 0.5 * gap, u[0], 0
    for i in range(t.size):
        moved = min(max(output, u[i] - half), u[i] + half)
        if i > 0 and moved != output:
            touch = output + half if moved > output else output - half
            share = (touch - u[i - 1]) / (u[i] - u[i - 1])
            if 0.0 < share < 1.0:
                times[count], values[count] = t[i - 1] + share * (t[i] - t[i - 1]), output
                count += 1
        output = moved
        times[count], values[count] = t[i], output
        count += 1
    return times[:count], values[:count]


@inlined
def rate_limit(t: FloatArray, u: FloatArray, inverse_rate: float) -> Nodes:
    """Rate limit: follow u with |dy/dt| ≤ 1/inverse_rate; zero means no limit."""
    if inverse_rate <= 0.0:
        return t, u
    fastest = 1.0 / inverse_rate
    times, values = np.empty(2 * t.size), np.empty(2 * t.size)
    times[0], values[0] = t[0], u[0]
    output, count = u[0], 1
    for i in range(1, t.size):
        h = t[i] - t[i - 1]
        if h <= 0.0:
            continue
        slope = (u[i] - u[i - 1]) / h
        behind = u[i - 1] - output
        side = np.sign(behind) if behind != 0.0 else np.sign(slope)
        closing = fastest - side * slope
        if behind != 0.0 and 0.0 < abs(behind) < closing * h:
            caught = abs(behind) / closing
            output = u[i - 1] + slope * caught
            times[count], values[count] = t[i - 1] + caught, output
            count += 1
            step = fastest * (h - caught)
            output = min(max(u[i], output - step), output + step)
        else:
            output = min(max(u[i], output - fastest * h), output + fastest * h)
        times[count], values[count] = t[i], output
        count += 1
    return times[:count], values[:count]


@inlined
def refine_for_decay(t: FloatArray, u: FloatArray, time_constant: float, parts: int) -> Nodes:
    """Split every stretch into ``parts``, closest where an e^(−t/T) that begins with the stretch is steepest.

    Nodes at −1.5·T·ln(1 − j/parts) are those with which straight lines keep most of the decay's mean squared
    rate; none is farther from its neighbour than in equal parts.
    """
    n = t.size
    times, values = np.empty(parts * (n - 1) + 1), np.empty(parts * (n - 1) + 1)
    after = np.empty(parts)
    for j in range(parts):
        after[j] = -1.5 * time_constant * np.log(1.0 - j / parts)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        for j in range(parts):
            share = min(j / parts, after[j] / h) if h > 0.0 else 0.0
            times[parts * i + j] = t[i] + share * h
            values[parts * i + j] = u[i] + share * (u[i + 1] - u[i])
    times[-1], values[-1] = t[n - 1], u[n - 1]
    return times, values


@inlined
def first_order_lag(t: FloatArray, u: FloatArray, time_constant: float) -> FloatArray:
    """First-order lag: exact solution of T·ẏ + y = u at the nodes of u, from the steady state y = u[0]."""
    y = u.copy()
    if time_constant <= 0.0:
        return y
    for i in range(1, u.size):
        h = t[i] - t[i - 1]
        if h <= 0.0:
            y[i] = y[i - 1]
            continue
        slope = (u[i] - u[i - 1]) / h
        decay = np.exp(-h / time_constant)
        y[i] = u[i] - slope * time_constant + (y[i - 1] - u[i - 1] + slope * time_constant) * decay
    return y


@inlined
def sensor_lag(t: FloatArray, x: FloatArray, owner: IntArray, time_constant: float) -> FloatArray:
    """First-order lag of the outputs of windows (rows of one ``owner`` each), each from a steady ramp."""
    y = x.copy()
    before, decay = -1.0, 0.0
    for i in range(x.size):
        if i == 0 or owner[i] != owner[i - 1]:
            if i + 1 < x.size and owner[i + 1] == owner[i]:
                y[i] = x[i] - time_constant * (x[i + 1] - x[i]) / (t[i + 1] - t[i])
            continue
        h = t[i] - t[i - 1]
        if h <= 0.0:
            y[i] = y[i - 1]
            continue
        if h != before:
            before, decay = h, np.exp(-h / time_constant)
        behind = time_constant * (x[i] - x[i - 1]) / h
        y[i] = x[i] - behind + (y[i - 1] - x[i - 1] + behind) * decay
    return y


@inlined
def lag_in_lines(t: FloatArray, u: FloatArray, time_constant: float, parts: int) -> Nodes:
    """First-order lag T·ẏ + y = u as nodes: a straight line in each of ``parts`` per stretch.

    y is solved exactly from the steady state u[0]. A line is the least-squares fit to it (equal mean and
    first moment), so there are small jumps between parts.
    """
    times, values = np.empty(2 * parts * t.size), np.empty(2 * parts * t.size)
    times[0], values[0] = t[0], u[0]
    y, count = u[0], 1
    for i in range(1, t.size):
        h = (t[i] - t[i - 1]) / parts
        if h <= 0.0:
            continue
        rise = (u[i] - u[i - 1]) / parts
        z = h / time_constant
        decay = np.exp(-z)
        mean, slope = line_through_decay(z, decay)
        for j in range(parts):
            start = u[i - 1] + j * rise - rise / z
            away = y - start
            times[count], values[count] = t[i - 1] + j * h, start + away * (mean - 0.5 * slope)
            end = start + rise
            times[count + 1], values[count + 1] = t[i - 1] + (j + 1) * h, end + away * (mean + 0.5 * slope)
            y = end + away * decay
            count += 2
    return times[:count], values[:count]


@inlined
def line_through_decay(z: float, decay: float) -> tuple[float, float]:
    """Mean and slope of the least-squares line through e^(−z·s) on s = 0 … 1; ``decay`` is e^(−z)."""
    if z < 0.02:
        return 1.0 - z * (0.5 - z * (1.0 / 6.0 - z / 24.0)), -z * (1.0 - z * (0.5 - z * 0.15))
    mean = (1.0 - decay) / z
    return mean, 12.0 * ((mean - decay) / z - 0.5 * mean)
