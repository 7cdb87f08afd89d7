"""How a command reaches a part, moment after moment of every sample period, for commands that are held."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any

import numba
import numpy as np

from labhil.compiled import compiled
from labhil.errors import UsageError
from labhil.plants.ball_beam import moments_of
from labhil.plants.friction import Friction
from labhil.plants.input_path import HISTORY, NEUTRAL, InputPath, follow, settled
from labhil.plants.mover import Body, Push, move, mover_for
from labhil.signals import FloatArray

JUMP = 1e-9
"""How long (s) a step of a held command takes on its way through the effects."""


class Drive:
    """The way of a command into a plant: what it remembers, and the moments into which a period is cut."""

    def __init__(self, values: Mapping[str, float], period: float, held: bool) -> None:
        if not 0.0 < period < float("inf"):
            raise UsageError(f"the period must be a positive number of seconds, found {period:g}")
        self.path = InputPath.of(values)
        self.held = held
        if self.path.delay > (HISTORY - 2) * period:
            raise UsageError(f"time_delay.delay is too long for a sample period of {period:g} s")
        self.moments = moments_of(self.path.delay / period) if self.path != NEUTRAL else np.ones(1)
        self.start(0.0)

    def start(self, value: float) -> None:
        """Settle at a command of ``value``, as after a long time."""
        self.memory = settled(value, self.path)
        self.history = np.full(HISTORY, value)
        self.newest = 0


@compiled
def command_at(history: FloatArray, newest: int, behind: float, held: bool) -> float:
    """The command ``behind`` sample periods before the end of the newest period."""
    whole = int(np.floor(behind))
    # a held command of the period that ends at sample n is that of sample n − 1
    earlier = history[(newest - whole - 1) % HISTORY]
    if held:
        return float(earlier)
    later = history[(newest - whole) % HISTORY]
    return float(later + (behind - whole) * (earlier - later))


def period_of(
    state: FloatArray, history: FloatArray, newest: int, memory: FloatArray, moments: FloatArray,
    period: float, held: bool, b: Body, m: Any, f: Friction, p: InputPath,
) -> None:  # fmt: skip
    """Let one sample period pass; ``history`` up to ``newest`` holds the commands at the samples."""
    passed = 0.0
    for moment in moments:
        h = (moment - passed) * period
        behind = p.delay / period
        if held:
            wanted = command_at(history, newest, behind + 1.0 - 0.5 * (moment + passed), True)
            before = follow(memory, wanted, JUMP, p)
        else:
            wanted = command_at(history, newest, behind + 1.0 - moment, False)
            before = memory[-1]
        passed = moment
        after = follow(memory, wanted, h, p)
        move(state, before, (after - before) / h, h, b, m, f)


def periods_for(push: Push) -> Callable[..., None]:
    """:func:`period_of` compiled for a rig's push, to be called by a kernel that is kept on disk."""
    scope = {**globals(), "move": mover_for(push)}
    bound: Callable[..., None] = numba.njit(nogil=True)(FunctionType(period_of.__code__, scope, "period_of"))
    return bound
