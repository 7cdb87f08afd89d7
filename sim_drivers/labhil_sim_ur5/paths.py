"""Composed motions: several moves with blends, and a tool speed until a contact."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from labhil.signals import FloatArray
from labhil_sim_ur5.following import ToolSpeed
from labhil_sim_ur5.kinematics import Geometry
from labhil_sim_ur5.motion import Halt, Motion, Plan


class UntilContact:
    """A tool speed until a contact, then a stop.

    Args:
        speed: The motion until the contact.
        stop: Returns the stop from a plan.
        is_touched: Returns whether there is a contact.
    """

    def __init__(
        self, speed: ToolSpeed, stop: Callable[[Plan], Halt], is_touched: Callable[[], bool]
    ) -> None:
        self._motion: Motion = speed
        self._stop, self._is_touched = stop, is_touched
        self._plan: Plan | None = None
        self.done = False

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan."""
        if self._plan is not None and not isinstance(self._motion, Halt) and self._is_touched():
            self._motion = self._stop(self._plan)
        self._plan = self._motion.advance(h)
        self.done = self._motion.done
        return self._plan


class Path:
    """A sequence of moves; with a blend radius the next move begins before the previous has ended.

    In a blend both moves are added, so that the path is smooth.

    Args:
        arm: Lengths of the arm.
        begin: Angles at the start, (6,) rad.
        moves: For each move: a function that makes it from its start, its end and its blend radius, m.
        on_move: Called with the index of each move that begins.
    """

    def __init__(
        self,
        arm: Geometry,
        begin: FloatArray,
        moves: Sequence[tuple[Callable[[FloatArray], Motion], FloatArray, float]],
        on_move: Callable[[int], None],
    ) -> None:
        self._arm, self._moves, self._on_move = arm, moves, on_move
        self._next_index = 0
        self._motion: Motion | None = None
        self._end = begin.copy()
        self._next_motion: Motion | None = None
        self._plan = Plan.resting(begin)
        self.done = not moves

    def advance(self, h: float) -> Plan:
        """Advance by h (s) and return the plan."""
        if self._motion is None:
            self._motion = self._start_next()
        plan = self._motion.advance(h)
        corner = self._end
        if (
            self._next_motion is None
            and self._next_index < len(self._moves)
            and self._in_blend(plan.q, corner)
        ):
            self._next_motion, self._corner = self._start_next(), corner
        elif self._next_motion is not None:
            blended = self._next_motion.advance(h)
            plan = Plan(plan.q + blended.q - self._corner, plan.qd + blended.qd, plan.qdd + blended.qdd)
        if self._motion.done:
            self._motion, self._next_motion = self._next_motion, None
            self.done = self._motion is None and self._next_index >= len(self._moves)
        return plan

    def _start_next(self) -> Motion:
        make, end, _ = self._moves[self._next_index]
        self._on_move(self._next_index)
        motion = make(self._end)
        self._end = end
        self._next_index += 1
        return motion

    def _in_blend(self, q: FloatArray, corner: FloatArray) -> bool:
        """Whether the flange is within the blend radius of the end of the present move."""
        radius = self._moves[self._next_index - 1][2]
        if radius <= 0.0:
            return False
        position, corner_position = self._arm.pose(q)[:3], self._arm.pose(corner)[:3]
        return float(np.linalg.norm(np.subtract(position, corner_position))) < radius
