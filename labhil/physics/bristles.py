"""Presliding: dry friction that turns over a short way after a reversal, as bristles do that bend.

Bristles bend by b, from −1 to 1: db = (dx − b·|dx|)/ℓ over the way x (m), with the presliding length ℓ (m),
the dry friction over their stiffness (Dahl 1968). Dry friction acts as dry·(b + τ·db/dt), with the time
constant τ (s), their damping over their stiffness (LuGre: Canudas de Wit, Olsson, Åström, Lischinsky 1995).
Between reversals b is an exact function of the way, so it needs no integration, however stiff they are.
"""

from __future__ import annotations

import numpy as np

from labhil.compiled import compiled, inlined
from labhil.signals import FloatArray, IntArray

SETTLED = 1e-3
"""Distance of the bend from its end value below which steps ignore it."""

MAX_STEP_SHARE = 0.3
"""Longest step, in presliding lengths and in radians of the oscillation on the bristles."""


@inlined
def bend_after(bend: float, side: float, way: float, length: float) -> float:
    """Bend after a way towards ``side``; without bristles (``length`` 0) it is ``side`` at once."""
    if side == 0.0:
        return bend
    if length <= 0.0:
        return side
    return side - (side - bend) * np.exp(min(-side * way / length, 1.0))


@inlined
def first_bend(pull: float, v: float, dry: float, length: float) -> float:
    """Bend at the start of a window, which nobody measures.

    That of steady motion; where friction ``dry`` stops the part within the presliding ``length``, the one
    that balances ``pull``, the acceleration without friction.
    """
    if length > 0.0 and v * v < 2.0 * dry * length:
        return min(max(pull / dry, -1.0), 1.0)
    return np.sign(v)


@inlined
def share_of_dry_friction(v: float, bend: float, length: float, time_constant: float) -> float:
    """Share of dry friction that acts, b + τ·db/dt."""
    if time_constant == 0.0 or length <= 0.0:
        return bend
    return bend + time_constant * (v - abs(v) * bend) / length


@inlined
def max_step(v: float, left: float, dry: float, length: float, time_constant: float) -> float:
    """Longest step, s; ``left`` is the distance of the bend from its end value."""
    if length <= 0.0 or left < SETTLED:
        return np.inf
    stiffness = abs(dry) * left / length
    decay = min(1.0 / (time_constant * stiffness + 1e-300), length / (abs(v) + 1e-300))
    return MAX_STEP_SHARE * min(decay, 1.0 / np.sqrt(stiffness + 1e-300))


@compiled
def bends_along(x: FloatArray, v: FloatArray, owner: IntArray, length: float) -> FloatArray:
    """Bends (N,) along sampled positions and velocities (N,) of windows.

    ``owner`` (N,) is the window of each sample; each begins as in steady motion. A reversal between two
    samples counts from the first of them.
    """
    bends = np.sign(v)
    if length > 0.0:
        for k in range(1, x.size):
            if owner[k] == owner[k - 1]:
                way = x[k] - x[k - 1]
                bends[k] = bend_after(bends[k - 1], np.sign(way), way, length)
    return bends
