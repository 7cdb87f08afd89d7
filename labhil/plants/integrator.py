"""Integrate one moving part with dry friction by Dormand-Prince steps that end at every event.

The applied force is a compiled function of a rig. From the states, the acting input and the rig's parameters
it returns the force without friction, additional dry friction and a factor of the viscous friction, and it
writes the rates of the rig's own states. Coming to rest, break-away, impact on a stop and the slipping of a
Maxwell-slip element are located by bisection of the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np

from labhil.compiled import compiled, specialised
from labhil.plants.friction import (
    Friction,
    bristle_force,
    bristle_level,
    bristle_rate,
    hold_level,
    on_bristles,
    resistance,
    side_of,
    viscous_force,
)
from labhil.plants.maxwell import (
    all_stick,
    elements_drag,
    held_force,
    let_slip,
    some_yield,
)
from labhil.signals import FloatArray

X, V, BRISTLE, LAG, SENSOR, PLANT_STATES = range(6)
"""Indices of the states: position, velocity, bristles, lags of the input path and the sensor, the rig's own.

States of Maxwell-slip elements follow those of the rig.
"""
SIDE, STEP_LENGTH = range(2)
"""Indices of the mode: side towards which the part moves (0 at rest), and length of the next step, s."""
STAGES = 7
BISECTIONS = 50
MIN_BOUNCE_SPEED = 1e-4
"""Speed (unit/s) below which a part stays at a stop."""
MIN_STEP = 1e-13
"""Step (s) that is accepted with any error."""
MIN_REVERSAL_STEP = 1e-9
"""Step (s) below which a reversal and return of the velocity within it is ignored."""
MIN_STATE_SIZE = 1e-6
"""Least size (SI) of a state to which its error is relative."""

NODES = np.array([0.0, 1.0 / 5.0, 3.0 / 10.0, 4.0 / 5.0, 8.0 / 9.0, 1.0, 1.0])
WEIGHTS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1.0 / 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
        [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
        [19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0, 0.0, 0.0],
        [9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0, 0.0],
        [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
    ]
)
ERROR = np.array(
    [
        71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339200.0, 22.0 / 525.0, -1.0 / 40.0,
    ]
)  # fmt: skip
"""Dormand and Prince's pair of orders 5 and 4; the last stage is at the end of the step."""


class Body(NamedTuple):
    """The moving part.

    Attributes:
        inertia: Mass or moment of inertia.
        low: Lower stop; −∞ without one.
        high: Upper stop; ∞ without one.
        restitution: Speed after an impact on a stop over the speed before.
        lag: Time constant of the input path, s; 0 without a lag.
        sensor_lag: Time constant of the sensor, s; 0 without a lag.
        measured_state: Index of the state that the sensor follows.
        tolerance: Error of a step relative to the size of the state.
    """

    inertia: float
    low: float
    high: float
    restitution: float
    lag: float
    sensor_lag: float
    measured_state: int
    tolerance: float


class Workspace(NamedTuple):
    """Work arrays: stages (7, n), end of a step (n,), and largest sizes of the states so far (n,)."""

    stages: FloatArray
    end: FloatArray
    sizes: FloatArray


def applied_force(s: FloatArray, u: float, m: Any, rates: FloatArray) -> tuple[float, float, float]:
    """Placeholder that :func:`compile_integrator` replaces by the applied force of a rig."""
    return 0.0, 0.0, 1.0


def update_memory(s: FloatArray, u: float, m: Any) -> None:
    """Placeholder that :func:`compile_integrator` replaces by the update of a rig's memory after a step."""


@compiled
def lagged_input(s: FloatArray, u: float, b: Body) -> float:
    """Return the input after the lag of the input path."""
    return float(s[LAG]) if b.lag > 0.0 else u


def derivatives(
    s: FloatArray, u: float, side: float, b: Body, m: Any, f: Friction, rates: FloatArray
) -> None:
    """Write the rates (n,) of all states of a part that moves towards ``side``, or is at rest (0)."""
    force, extra_level, viscosity = applied_force(s, lagged_input(s, u, b), m, rates)
    x, v = s[X], s[V]
    rates[LAG] = (u - s[LAG]) / b.lag if b.lag > 0.0 else 0.0
    rates[SENSOR] = (s[b.measured_state] - s[SENSOR]) / b.sensor_lag if b.sensor_lag > 0.0 else 0.0
    rates[X], rates[V], rates[BRISTLE] = 0.0, 0.0, 0.0
    element_force = elements_drag(s, x, v, side, extra_level, f, rates) if f.attraction > 0.0 else 0.0
    if side == 0.0:
        return
    drag = (viscosity - 1.0) * f.viscous * v
    if f.attraction > 0.0:
        drag += viscous_force(v, f) + element_force
    elif f.stiffness > 0.0:
        level = bristle_level(x, v, side_of(v), f, extra_level)
        rates[BRISTLE] = bristle_rate(s[BRISTLE], v, level, f)
        drag += viscous_force(v, f) + bristle_force(s[BRISTLE], v, level, f)
    else:
        drag += resistance(x, v, side, f, extra_level)
    rates[X], rates[V] = v, (force - drag) / b.inertia


def break_away_side(s: FloatArray, u: float, b: Body, m: Any, f: Friction, rates: FloatArray) -> float:
    """Return the side towards which a part at rest breaks away; 0 if it holds or is against a stop."""
    force, extra_level, _ = applied_force(s, lagged_input(s, u, b), m, rates)
    x = s[X]
    if f.stiffness > 0.0:
        # bristles and elements do not hold by themselves: the part is at rest on a stop, or in equilibrium
        force -= held_force(s) if f.attraction > 0.0 else f.stiffness * s[BRISTLE]
        held = (x >= b.high and force >= 0.0) or (x <= b.low and force <= 0.0)
        if f.attraction > 0.0:
            return 0.0 if held else side_of(force)
        return 0.0 if held else 1.0
    if force > hold_level(x, 1.0, f, extra_level) and x < b.high:
        return 1.0
    if -force > hold_level(x, -1.0, f, extra_level) and x > b.low:
        return -1.0
    return 0.0


def try_step(
    s: FloatArray, u: float, rise: float, h: float, side: float,
    b: Body, m: Any, f: Friction, w: Workspace,
) -> None:  # fmt: skip
    """Step from the states ``s`` to ``w.end`` within h (s); the input starts at ``u`` with slope ``rise``."""
    k, end = w.stages, w.end
    for stage in range(STAGES):
        for j in range(s.size):
            change = 0.0
            for i in range(stage):
                change += WEIGHTS[stage, i] * k[i, j]
            end[j] = s[j] + h * change
        derivatives(end, u + NODES[stage] * h * rise, side, b, m, f, k[stage])


@compiled
def relative_error(h: float, b: Body, w: Workspace) -> float:
    """Return the estimated error of the last step of h (s), relative to the tolerance."""
    worst = 0.0
    for j in range(w.end.size):
        error = 0.0
        for i in range(STAGES):
            error += ERROR[i] * w.stages[i, j]
        worst = max(worst, abs(h * error) / max(w.sizes[j], abs(w.end[j])))
    return worst / b.tolerance


def has_event(
    y: FloatArray, u: float, side: float, at_stop: bool, b: Body, m: Any, f: Friction, w: Workspace
) -> bool:
    """Whether a part at rest has broken away, or a moving one has reversed or has an element that slips.

    With ``at_stop``, whether a moving one has passed a stop. ``y`` is the end of the last step.
    """
    if side == 0.0:
        return bool(break_away_side(y, u, b, m, f, w.stages[6]) != 0.0)
    if at_stop:
        return bool(y[X] > b.high or y[X] < b.low)
    if on_bristles(f):
        return False
    if f.attraction > 0.0 and some_yield(y, side, w.stages[6, y.size - 1]):
        return True
    return bool(y[V] * side < 0.0)


def locate_event(
    s: FloatArray, u: float, rise: float, h: float, side: float, at_stop: bool,
    b: Body, m: Any, f: Friction, w: Workspace,
) -> float:  # fmt: skip
    """Return the time of an event within h (s); ``w.end`` is then the state after it."""
    low, high = 0.0, h
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        try_step(s, u, rise, middle, side, b, m, f, w)
        if has_event(w.end, u + middle * rise, side, at_stop, b, m, f, w):
            high = middle
        else:
            low = middle
    try_step(s, u, rise, high, side, b, m, f, w)
    return high


def may_reverse(s: FloatArray, h: float, side: float, f: Friction, w: Workspace) -> bool:
    """Whether the velocity may have changed its sign and returned within the step of h (s)."""
    if on_bristles(f) or side == 0.0:
        return False
    before, after = w.stages[0, V] * side, w.stages[6, V] * side
    if before >= 0.0 or after <= 0.0 or h < MIN_REVERSAL_STEP:
        return False
    # a convex curve is above the intersection of its first and last tangents
    tangent_velocity = (side * (w.end[V] - s[V]) - after * h) / (before - after)
    return bool(side * s[V] + before * tangent_velocity <= 0.0)


def come_to_rest(mode: FloatArray, f: Friction, w: Workspace) -> None:
    """Set the part at rest at ``w.end``."""
    w.end[V] = 0.0
    if f.attraction > 0.0:
        all_stick(w.end)
    mode[SIDE] = 0.0


def hit_stop(mode: FloatArray, b: Body, f: Friction, w: Workspace) -> None:
    """Let the part bounce off the stop at ``w.end``, or stay there."""
    side = 1.0 if w.end[X] > b.high else -1.0
    w.end[X] = b.high if side > 0.0 else b.low
    back = b.restitution * abs(w.end[V])
    w.end[V] = -side * back if back > MIN_BOUNCE_SPEED else 0.0
    mode[SIDE] = 1.0 if on_bristles(f) and w.end[V] != 0.0 else side_of(w.end[V])
    if f.attraction > 0.0:
        all_stick(w.end)


def apply_event(
    s: FloatArray,
    mode: FloatArray,
    u: float,
    rise: float,
    h: float,
    b: Body,
    m: Any,
    f: Friction,
    w: Workspace,
) -> float:
    """Shorten a step of h (s) to its first event, and apply that; return the time of the step."""
    side, elapsed = mode[SIDE], h
    if side == 0.0:
        if has_event(w.end, u + h * rise, side, False, b, m, f, w):
            elapsed = locate_event(s, u, rise, h, side, False, b, m, f, w)
            mode[SIDE] = break_away_side(w.end, u + elapsed * rise, b, m, f, w.stages[6])
        return elapsed
    is_event = has_event(w.end, u + h * rise, side, False, b, m, f, w)
    if is_event:
        elapsed = locate_event(s, u, rise, h, side, False, b, m, f, w)
        if b.low <= w.end[X] <= b.high:
            if w.end[V] * side < 0.0:
                come_to_rest(mode, f, w)
            else:
                let_slip(w.end, side, w.stages[6, s.size - 1])
            return elapsed
    if is_event or has_event(w.end, u + elapsed * rise, side, True, b, m, f, w):
        elapsed = locate_event(s, u, rise, elapsed, side, True, b, m, f, w)
        hit_stop(mode, b, f, w)
    return elapsed


def integrate(
    s: FloatArray,
    mode: FloatArray,
    u: float,
    rise: float,
    h: float,
    b: Body,
    m: Any,
    f: Friction,
    w: Workspace,
) -> None:
    """Integrate over h (s) with an input that starts at ``u`` and changes by ``rise`` per second."""
    t = 0.0
    while t < h and math.isfinite(s[V]):
        now = u + t * rise
        if mode[SIDE] == 0.0:
            mode[SIDE] = break_away_side(s, now, b, m, f, w.stages[6])
        step = min(mode[STEP_LENGTH], h - t)
        try_step(s, now, rise, step, mode[SIDE], b, m, f, w)
        error = relative_error(step, b, w)
        change = 0.2 if not error < 1e3 else min(0.9 * max(error, 1e-9) ** -0.2, 5.0)
        if step > MIN_STEP and (not error <= 1.0 or may_reverse(s, step, mode[SIDE], f, w)):
            mode[STEP_LENGTH] = step * min(change, 0.5)
            continue
        last = step == h - t
        mode[STEP_LENGTH] = max(mode[STEP_LENGTH], step * change) if last else step * change
        if not math.isfinite(w.end[V]):
            s[V] = math.nan
            return
        was_started = mode[SIDE] != 0.0 and s[V] == 0.0
        elapsed = apply_event(s, mode, now, rise, step, b, m, f, w)
        if was_started and mode[SIDE] == 0.0 and elapsed <= MIN_STEP and elapsed < step:
            # it stopped at once: the net force is below rounding, and the part stays at rest
            try_step(s, now, rise, step, 0.0, b, m, f, w)
            elapsed = step
        for j in range(s.size):
            s[j] = w.end[j]
            w.sizes[j] = max(w.sizes[j], abs(s[j]))
        update_memory(s, lagged_input(s, now + elapsed * rise, b), m)
        t = h if last and elapsed == step else t + elapsed


FUNCTIONS = (
    derivatives, break_away_side, try_step, has_event, locate_event, may_reverse, come_to_rest, hit_stop,
    apply_event, integrate,
)  # fmt: skip


def compile_integrator(
    applied_force: Callable[..., Any], update_memory: Callable[..., Any], rig: str
) -> Callable[..., None]:
    """Compile :func:`integrate` for a rig.

    numba cannot cache a compiled function that takes another one as an argument. So the functions of this
    module are compiled for each rig, with its applied force as a global, as functions of the rig's module.

    Args:
        applied_force: Compiled function of the rig (see the module).
        update_memory: Compiled function that updates what the rig remembers, after every step.
        rig: Name of the rig's module.

    Returns:
        The compiled function.
    """
    scope = {**globals(), "__name__": rig, "applied_force": applied_force, "update_memory": update_memory}
    for function in FUNCTIONS:
        scope[function.__name__] = specialised(FunctionType(function.__code__, scope, function.__name__))
    bound: Callable[..., None] = scope["integrate"]
    return bound
