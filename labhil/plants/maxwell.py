"""The generalised Maxwell-slip model: dry friction of elements that stick and slip one after the other.

Al-Bender, Lampaert and Swevers (2005), IEEE Transactions on Automatic Control 50, 1883–1887. Element i of N
bears the share αᵢ = 1/N of the dry level s(v):

    it sticks, dFᵢ/dt = kᵢ·v, until sgn(v)·Fᵢ reaches αᵢ·s(v);
    it slips,  dFᵢ/dt = C·(sgn(v)·αᵢ − Fᵢ/s(v)), until v changes sign.

Stiffnesses kᵢ fall from each element to the next by the same factor, so that one yields after the other. What
each one holds is kept until it yields: the hysteresis remembers every turning point that no larger swing has
wiped out. One thing is added: an element that slips is loaded no faster than one that sticks. A part that
slows down would else be given energy, since the level rises and the attraction does not wait for the way.

The elements are the last ``N_ELEMENT_STATES`` of a part's states: their forces (N); then for each the side
(±1) towards which it slips, or 0; and last the integral of the level over time (N·s), whose rate is the level
at the end of a step. Quantities of a rotor are N·m and rad.
"""

from __future__ import annotations

import math

from labhil.compiled import compiled
from labhil.plants.friction import ELEMENTS, Friction, bristle_level, side_of
from labhil.signals import FloatArray

N_ELEMENT_STATES = 2 * ELEMENTS + 1
MAX_ATTRACTION_RATE = 1e4
"""Largest rate (1/s) of the attraction C/s, which becomes infinite where the level goes to zero."""


@compiled
def all_stick(s: FloatArray) -> None:
    """Let every element stick where it is."""
    for slipping in range(s.size - N_ELEMENT_STATES + ELEMENTS, s.size - 1):
        s[slipping] = 0.0


@compiled
def some_yield(s: FloatArray, side: float, level: float) -> bool:
    """Whether a sticking element has more force towards ``side`` than its share of the level (N)."""
    for i in range(s.size - N_ELEMENT_STATES, s.size - N_ELEMENT_STATES + ELEMENTS):
        if s[i + ELEMENTS] != side and side * s[i] * ELEMENTS > level:
            return True
    return False


@compiled
def let_slip(s: FloatArray, side: float, level: float) -> None:
    """Let elements with their share of the level (N) slip towards ``side``; those that slipped back stick."""
    for i in range(s.size - N_ELEMENT_STATES, s.size - N_ELEMENT_STATES + ELEMENTS):
        if side * s[i] * ELEMENTS >= level:
            s[i + ELEMENTS] = side
        elif s[i + ELEMENTS] != side:
            s[i + ELEMENTS] = 0.0


@compiled
def attraction(level: float, f: Friction) -> float:
    """Return the rate C/s (1/s) at which an element that slips approaches its share of the level (N)."""
    return min(f.attraction / level, MAX_ATTRACTION_RATE) if level > 0.0 else MAX_ATTRACTION_RATE


@compiled
def held_force(s: FloatArray) -> float:
    """Return the force (N) of the springs of all elements."""
    force = 0.0
    for i in range(s.size - N_ELEMENT_STATES, s.size - N_ELEMENT_STATES + ELEMENTS):
        force += s[i]
    return force


@compiled
def elements_force(s: FloatArray, v: float, f: Friction) -> float:
    """Return the dry friction (N) at velocity v (m/s): springs, and the dampers of sticking elements."""
    stiffness, sticking = f.stiffest, 0.0
    for slipping in range(s.size - N_ELEMENT_STATES + ELEMENTS, s.size - 1):
        if s[slipping] * v <= 0.0:
            sticking += stiffness
        stiffness *= f.softening
    return held_force(s) + f.damping * sticking / f.stiffness * v


@compiled
def elements_drag(
    s: FloatArray, x: float, v: float, side: float, extra_level: float, f: Friction, rates: FloatArray
) -> float:
    """Return the dry friction (N) of a part that moves towards ``side``, or rests (0); write its rates (N/s).

    ``extra_level`` (N) is dry friction of a rig's own, as in :func:`labhil.plants.friction.dry_level`.
    """
    level = bristle_level(x, v, side, f, extra_level)
    rates[s.size - 1] = level
    stiffness, rate, share = f.stiffest, attraction(level, f), level / ELEMENTS
    for i in range(s.size - N_ELEMENT_STATES, s.size - N_ELEMENT_STATES + ELEMENTS):
        rates[i], rates[i + ELEMENTS] = stiffness * v, 0.0
        if s[i + ELEMENTS] != 0.0:
            rates[i] = side * min(rate * (share - side * s[i]), stiffness * abs(v))
        stiffness *= f.softening
    return elements_force(s, v, f)


@compiled
def relax_elements(s: FloatArray, v: float, level: float, h: float, f: Friction) -> None:
    """Advance the elements by h (s) at constant v (m/s) and level (N), by the exact solution."""
    side, share = side_of(v), level / ELEMENTS
    if side == 0.0:
        return
    let_slip(s, side, level)
    stiffness, decay = f.stiffest, math.exp(-attraction(level, f) * h)
    for i in range(s.size - N_ELEMENT_STATES, s.size - N_ELEMENT_STATES + ELEMENTS):
        before = side * s[i]
        force = before + stiffness * abs(v) * h
        if s[i + ELEMENTS] != 0.0:
            force = min(share + (before - share) * decay, force)
        elif force >= share:
            s[i + ELEMENTS], force = side, share
        s[i] = side * force
        stiffness *= f.softening
