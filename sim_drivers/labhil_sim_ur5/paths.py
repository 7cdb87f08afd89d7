"""Motions made of others: several moves with blends, a speed until something is touched."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from labhil.signals import FloatArray
from labhil_sim_ur5.following import ToolSpeed
from labhil_sim_ur5.kinematics import Geometry
from labhil_sim_ur5.motion import Halt, Motion, Plan


class UntilContact:
    """Tool speed until something is touched, then down to rest; ``touched`` says when."""

    def __init__(self, speed: ToolSpeed, stop: Callable[[Plan], Halt], touched: Callable[[], bool]) -> None:
        self._now: Motion = speed
        self._stop, self._touched = stop, touched
        self._plan: Plan | None = None
        self.done = False

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then."""
        if self._plan is not None and not isinstance(self._now, Halt) and self._touched():
            self._now = self._stop(self._plan)
        self._plan = self._now.advance(h)
        self.done = self._now.done
        return self._plan


class Path:
    """Moves one after the other; where a move has a blend radius the next begins before it has ended.

    ``moves`` make each move from the angles where the one before ends; both are added up in a blend, so that
    the way through it is smooth. ``begun`` is called with the number of each move that begins.
    """

    def __init__(
        self,
        arm: Geometry,
        begin: FloatArray,
        moves: Sequence[tuple[Callable[[FloatArray], Motion], FloatArray, float]],
        begun: Callable[[int], None],
    ) -> None:
        self._arm, self._moves, self._begun = arm, moves, begun
        self._next = 0
        self._now: Motion | None = None
        self._ends = begin.copy()
        self._later: Motion | None = None
        self._plan = Plan.resting(begin)
        self.done = not moves

    def advance(self, h: float) -> Plan:
        """Let h (s) pass and return the plan then."""
        if self._now is None:
            self._now = self._make()
        plan = self._now.advance(h)
        corner = self._ends
        if self._later is None and self._next < len(self._moves) and self._near(plan.q, corner):
            self._later, self._corner = self._make(), corner
        elif self._later is not None:
            other = self._later.advance(h)
            plan = Plan(plan.q + other.q - self._corner, plan.qd + other.qd, plan.qdd + other.qdd)
        if self._now.done:
            self._now, self._later = self._later, None
            self.done = self._now is None and self._next >= len(self._moves)
        return plan

    def _make(self) -> Motion:
        make, ends, _ = self._moves[self._next]
        self._begun(self._next)
        motion = make(self._ends)
        self._ends = ends
        self._next += 1
        return motion

    def _near(self, q: FloatArray, corner: FloatArray) -> bool:
        """Whether the flange is within the blend radius of where the present move ends."""
        radius = self._moves[self._next - 1][2]
        if radius <= 0.0:
            return False
        here, there = self._arm.pose(q)[:3], self._arm.pose(corner)[:3]
        return float(np.linalg.norm(np.subtract(here, there))) < radius
