"""Forces on the simulated ball, and its integration by steps that end at every event.

(M + J/R²)·ẍ = M·g·sin β + M·x·β̇² − (J/R)·β̈ − friction + other forces, sin β = ratio·sin γ.
The linkage's angle γ moves along straight lines; where two of them meet, β̇ jumps and the ball's
velocity with it, by −(J/R)/(M + J/R²)·Δβ̇. Events (coming to rest, breaking away, meeting a stop)
are located by bisection on a step of the integrator.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from labhil.compiled import compiled
from labhil.plants.friction import (
    Friction,
    bristle_force,
    bristle_level,
    hold_level,
    relax_bristles,
    resistance,
    side_of,
    viscous_force,
)
from labhil.plants.maxwell import N_ELEMENT_STATES, elements_force, relax_elements
from labhil.signals import FloatArray

STANDARD_GRAVITY = 9.81
MAX_STEP = 1e-3
BRISTLE_STEP = 1e-4
"""Step (s) of a ball on bristles or Maxwell-slip elements, which vibrates on them."""
BISECTIONS = 45
MIN_BOUNCE_SPEED = 5e-3
"""Speed (m/s) below which a ball stays at a stop."""

POSITION, VELOCITY, SIDE, BRISTLE, TILT_RATE = range(5)
BALL_SIZE = 5 + N_ELEMENT_STATES


class Mechanics(NamedTuple):
    """Masses, lengths and forces (SI). ``inertia`` is M + J/R² and what is added; ``rolling`` is J/R."""

    mass: float
    rolling: float
    inertia: float
    ratio: float
    force: float
    spring: float
    stop: float
    restitution: float
    magnet: float
    magnet_position: float
    magnet_width: float
    patch: float
    patch_position: float
    patch_width: float
    cable: float
    cable_start: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Mechanics:
        """Take them from the parameters of a plant."""
        mass, radius = values["ball_mass"], values["ball_radius"]
        ball_inertia = 0.4 * mass * radius**2
        return cls(
            mass=mass,
            rolling=ball_inertia / radius,
            inertia=mass + ball_inertia / radius**2 + values.get("added_inertia.mass", 0.0),
            ratio=values["crank_radius"] / values["beam_length"],
            force=values.get("constant_force.force", 0.0),
            spring=values.get("spring_force.stiffness", 0.0),
            stop=values["stop"],
            restitution=values["restitution"],
            magnet=values.get("hidden_magnet.pull", 0.0),
            magnet_position=values.get("hidden_magnet.place", 0.0),
            magnet_width=values.get("hidden_magnet.width", 1.0),
            patch=values.get("hidden_sticky_patch.level", 0.0),
            patch_position=values.get("hidden_sticky_patch.place", 0.0),
            patch_width=values.get("hidden_sticky_patch.width", 1.0),
            cable=values.get("hidden_cable.stiffness", 0.0),
            cable_start=values.get("hidden_cable.from", 0.0),
        )


@compiled
def tilt_rate(angle: float, crank_rate: float, m: Mechanics) -> float:
    """Return β̇ (rad/s) where the linkage stands at ``angle`` (rad) and turns with ``crank_rate`` (rad/s)."""
    sine = m.ratio * math.sin(angle)
    return m.ratio * math.cos(angle) * crank_rate / math.sqrt(1.0 - sine * sine)


@compiled
def driving_force(x: float, angle: float, crank_rate: float, m: Mechanics) -> float:
    """Return the force (N) on the ball without friction, at a constant crank rate."""
    sine = m.ratio * math.sin(angle)
    cosine = math.sqrt(1.0 - sine * sine)
    rate = m.ratio * math.cos(angle) * crank_rate / cosine
    curvature = (rate * rate - crank_rate * crank_rate) * sine / cosine
    by_tilt = m.mass * (STANDARD_GRAVITY * sine + x * rate * rate) - m.rolling * curvature
    force = by_tilt + m.force - m.spring * x
    if m.magnet != 0.0:
        offset = (x - m.magnet_position) / m.magnet_width
        force -= m.magnet * offset * math.exp(0.5 - 0.5 * offset * offset)
    if m.cable != 0.0 and x > m.cable_start:
        force -= m.cable * (x - m.cable_start)
    return force


@compiled
def patch_level(x: float, m: Mechanics) -> float:
    """Return the additional dry friction (N) of a sticky patch at x (m)."""
    if m.patch == 0.0:
        return 0.0
    offset = (x - m.patch_position) / m.patch_width
    return m.patch * math.exp(-0.5 * offset * offset)


@compiled
def roll_step(
    x: float, v: float, side: float, angle: float, crank_rate: float, h: float, m: Mechanics, f: Friction
) -> tuple[float, float]:
    """Return x and v of a ball that moves towards ``side``, h (s) later (classical Runge-Kutta)."""
    half = 0.5 * h
    middle, end = angle + half * crank_rate, angle + h * crank_rate
    a1 = (driving_force(x, angle, crank_rate, m) - resistance(x, v, side, f, patch_level(x, m))) / m.inertia
    x2, v2 = x + half * v, v + half * a1
    a2 = (
        driving_force(x2, middle, crank_rate, m) - resistance(x2, v2, side, f, patch_level(x2, m))
    ) / m.inertia
    x3, v3 = x + half * v2, v + half * a2
    a3 = (
        driving_force(x3, middle, crank_rate, m) - resistance(x3, v3, side, f, patch_level(x3, m))
    ) / m.inertia
    x4, v4 = x + h * v3, v + h * a3
    a4 = (driving_force(x4, end, crank_rate, m) - resistance(x4, v4, side, f, patch_level(x4, m))) / m.inertia
    return x + h * (v + 2.0 * (v2 + v3) + v4) / 6.0, v + h * (a1 + 2.0 * (a2 + a3) + a4) / 6.0


@compiled
def max_step(
    x: float, v: float, side: float, angle: float, crank_rate: float, m: Mechanics, f: Friction
) -> float:
    """Return how long a step (s) may be: short against the time to cross the Stribeck velocity."""
    if f.stribeck == 0.0:
        return MAX_STEP
    acceleration = (
        abs(driving_force(x, angle, crank_rate, m) - resistance(x, v, side, f, patch_level(x, m))) / m.inertia
    )
    return min(MAX_STEP, 0.2 * (f.stribeck_velocity + abs(v)) / (acceleration + 1e-9))


@compiled
def break_away_side(x: float, force: float, m: Mechanics, f: Friction) -> float:
    """Return the side towards which ``force`` (N) moves a ball at rest, 0 when it holds; stops hold too."""
    if force > hold_level(x, 1.0, f, patch_level(x, m)) and x < m.stop:
        return 1.0
    if -force > hold_level(x, -1.0, f, patch_level(x, m)) and x > -m.stop:
        return -1.0
    return 0.0


@compiled
def rest(
    x: float, angle: float, crank_rate: float, h: float, m: Mechanics, f: Friction
) -> tuple[float, float]:
    """Return the time (s, at most h) that a ball stays at rest, and the side of its break-away (0: none)."""
    immediate_side = break_away_side(x, driving_force(x, angle, crank_rate, m), m, f)
    if immediate_side != 0.0:
        return 0.0, immediate_side
    side = break_away_side(x, driving_force(x, angle + h * crank_rate, crank_rate, m), m, f)
    if side == 0.0:
        return h, 0.0
    low, high = 0.0, h
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if break_away_side(x, driving_force(x, angle + middle * crank_rate, crank_rate, m), m, f) != 0.0:
            high = middle
        else:
            low = middle
    return high, side


@compiled
def time_to_event(
    x: float,
    v: float,
    side: float,
    angle: float,
    crank_rate: float,
    h: float,
    at_stop: bool,
    m: Mechanics,
    f: Friction,
) -> float:
    """Return the time within h (s) at which the ball comes to rest, or with ``at_stop`` reaches the stop."""
    low, high = 0.0, h
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        position, speed = roll_step(x, v, side, angle, crank_rate, middle, m, f)
        passed = position * side > m.stop if at_stop else speed * side < 0.0
        if passed:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@compiled
def bounce(v: float, m: Mechanics) -> float:
    """Return the velocity (m/s) after meeting a stop with v."""
    return -m.restitution * v if m.restitution * abs(v) > MIN_BOUNCE_SPEED else 0.0


@compiled
def roll_to_event(
    ball: FloatArray, angle: float, crank_rate: float, h: float, m: Mechanics, f: Friction
) -> float:
    """Move a rolling ball by at most h (s), up to its next event; return the time of the step."""
    x, v, side = ball[POSITION], ball[VELOCITY], ball[SIDE]
    reached, speed = roll_step(x, v, side, angle, crank_rate, h, m, f)
    if speed * side <= 0.0:
        if v == 0.0:
            # the net force is below rounding: the ball stays at rest for this step
            ball[SIDE] = 0.0
            return h
        elapsed = time_to_event(x, v, side, angle, crank_rate, h, False, m, f)
        reached, _ = roll_step(x, v, side, angle, crank_rate, elapsed, m, f)
        if reached * side <= m.stop:
            ball[POSITION], ball[VELOCITY], ball[SIDE] = reached, 0.0, 0.0
            return elapsed
    if reached * side > m.stop:
        elapsed = time_to_event(x, v, side, angle, crank_rate, h, True, m, f)
        _, speed = roll_step(x, v, side, angle, crank_rate, elapsed, m, f)
        ball[POSITION], ball[VELOCITY] = side * m.stop, bounce(speed, m)
        ball[SIDE] = side_of(ball[VELOCITY])
        return elapsed
    ball[POSITION], ball[VELOCITY] = reached, speed
    return h


@compiled
def move_by_events(
    ball: FloatArray, angle: float, crank_rate: float, h: float, m: Mechanics, f: Friction
) -> None:
    """Move the ball over one straight line of the linkage, through all its stops and starts."""
    t = 0.0
    while t < h:
        now = angle + t * crank_rate
        remaining = min(h - t, MAX_STEP)
        if ball[SIDE] == 0.0:
            elapsed, side = rest(ball[POSITION], now, crank_rate, remaining, m, f)
            ball[SIDE] = side
            t += elapsed
        else:
            remaining = min(
                remaining, max_step(ball[POSITION], ball[VELOCITY], ball[SIDE], now, crank_rate, m, f)
            )
            t += roll_to_event(ball, now, crank_rate, remaining, m, f)


@compiled
def update_bristles(ball: FloatArray, x: float, v: float, h: float, m: Mechanics, f: Friction) -> None:
    """Let bristles or elements follow a ball at x (m) that moves with v (m/s) for h (s)."""
    level = bristle_level(x, v, side_of(v), f, patch_level(x, m))
    if f.attraction > 0.0:
        relax_elements(ball, v, level, h, f)
    else:
        ball[BRISTLE] = relax_bristles(ball[BRISTLE], v, level, h, f)


@compiled
def carried_friction(ball: FloatArray, x: float, v: float, m: Mechanics, f: Friction) -> float:
    """Return the whole friction (N) on a ball at x (m) that moves with v (m/s) on bristles or elements."""
    if f.attraction > 0.0:
        return elements_force(ball, v, f) + viscous_force(v, f)
    level = bristle_level(x, v, side_of(v), f, patch_level(x, m))
    return bristle_force(ball[BRISTLE], v, level, f) + viscous_force(v, f)


@compiled
def move_on_bristles(
    ball: FloatArray, angle: float, crank_rate: float, h: float, m: Mechanics, f: Friction
) -> None:
    """Move the ball over one straight line of the linkage, on bristles or elements."""
    steps = math.ceil(h / BRISTLE_STEP)
    d = h / steps
    x, v = ball[POSITION], ball[VELOCITY]
    for i in range(steps):
        middle = angle + (i + 0.5) * d * crank_rate
        update_bristles(ball, x, v, 0.5 * d, m, f)
        a = (driving_force(x, middle, crank_rate, m) - carried_friction(ball, x, v, m, f)) / m.inertia
        x_half, v_half = x + 0.5 * d * v, v + 0.5 * d * a
        a = (
            driving_force(x_half, middle, crank_rate, m) - carried_friction(ball, x_half, v_half, m, f)
        ) / m.inertia
        x, v = x + d * (v + 0.5 * d * a), v + d * a
        update_bristles(ball, x, v, 0.5 * d, m, f)
        if abs(x) > m.stop and x * v > 0.0:
            x, v = side_of(x) * m.stop, bounce(v, m)
    ball[POSITION], ball[VELOCITY], ball[SIDE] = x, v, side_of(v)


@compiled
def move(ball: FloatArray, before: float, after: float, h: float, m: Mechanics, f: Friction) -> None:
    """Move the ball while the linkage turns straight from ``before`` to ``after`` (rad) within h (s)."""
    crank_rate = (after - before) / h
    velocity_step = m.rolling / m.inertia * (tilt_rate(before, crank_rate, m) - ball[TILT_RATE])
    if velocity_step != 0.0:
        ball[VELOCITY] -= velocity_step
        if abs(ball[POSITION]) >= m.stop and ball[POSITION] * ball[VELOCITY] > 0.0:
            ball[VELOCITY] = 0.0
        ball[SIDE] = side_of(ball[VELOCITY])
    if f.stiffness > 0.0:
        move_on_bristles(ball, before, crank_rate, h, m, f)
    else:
        move_by_events(ball, before, crank_rate, h, m, f)
    ball[TILT_RATE] = tilt_rate(after, crank_rate, m)
