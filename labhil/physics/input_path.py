"""Effects between the command and the mechanism, shared by every rig; all act on angles or volts.

A signal is given at nodes, straight in between: times ``t`` (n,) and values ``u`` (n,). Each effect
returns new nodes: where it bends the signal between two samples, a node is added at that very moment,
so that nothing depends on how a bend falls between samples. Each walks once through the whole
recording, so that what it remembers (a gap's side, a lag's state) comes from the whole past and not
from the start of a window.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import inlined
from labhil.signals import FloatArray, IntArray

Nodes = tuple[FloatArray, FloatArray]


@inlined
def with_crossings(t: FloatArray, u: FloatArray, low: float, high: float) -> Nodes:
    """Add nodes where the signal passes the levels ``low`` and ``high``."""
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
    """No output between −left and right, shifted beyond (eq. 4.18 of the reference text)."""
    t, u = with_crossings(t, u, -left, right)
    return t, np.maximum(u - right, 0.0) + np.minimum(u + left, 0.0)


@inlined
def saturation(t: FloatArray, u: FloatArray, inverse_limit: float) -> Nodes:
    """Clip to ±1/inverse_limit; zero means no limit."""
    if inverse_limit <= 0.0:
        return t, u
    limit = 1.0 / inverse_limit
    t, u = with_crossings(t, u, -limit, limit)
    return t, np.minimum(np.maximum(u, -limit), limit)


@inlined
def backlash(t: FloatArray, u: FloatArray, gap: float) -> Nodes:
    """Play operator of full width ``gap`` (unit of u); begins in the middle of its play."""
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
    """Follow u no faster than 1/inverse_rate per second; zero means as fast as it likes."""
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
def refine(t: FloatArray, u: FloatArray, parts: int) -> Nodes:
    """Cut every stretch into equal parts: for what follows to bend the signal smoothly between samples."""
    n = t.size
    times, values = np.empty(parts * (n - 1) + 1), np.empty(parts * (n - 1) + 1)
    for i in range(n - 1):
        for j in range(parts):
            share = j / parts
            times[parts * i + j] = t[i] + share * (t[i + 1] - t[i])
            values[parts * i + j] = u[i] + share * (u[i + 1] - u[i])
    times[-1], values[-1] = t[n - 1], u[n - 1]
    return times, values


@inlined
def first_order_lag(t: FloatArray, u: FloatArray, time_constant: float) -> FloatArray:
    """Solve T·ẏ + y = u exactly for u that is straight between nodes; begins settled at u[0]."""
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
    """The same of windows, rows of one ``owner`` (N,) each; every one begins as after a steady slope."""
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
    """Nodes of y from T·ẏ + y = u, each stretch cut into ``parts`` with a straight line in each.

    y is solved exactly; a line is the best one through it (least squares, so that its mean and its first
    moment are y's own), and jumps a little from part to part. Begins settled at u[0].
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
    """Mean and slope of the straight line that fits e^(−z·s) best for s from 0 to 1; ``decay`` is e^(−z)."""
    if z < 0.02:
        return 1.0 - z * (0.5 - z * (1.0 / 6.0 - z / 24.0)), -z * (1.0 - z * (0.5 - z * 0.15))
    mean = (1.0 - decay) / z
    return mean, 12.0 * ((mean - decay) / z - 0.5 * mean)
