"""A force that no named term describes, beside a kernel's laws: a curve along the motion or a course.

:func:`with_extra` makes of the laws of any moving part (see ``physics.moving_part``) those of the same part
under one more force, so a kernel without it stays what it is. A curve is a table over the part's own
position or velocity while it is simulated, never over the measured ones: a force that knew the measurement
would pull the simulation towards it (a stiff spring to the measured place explains any record).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from labhil.compiled import inlined, specialised
from labhil.physics.friction import RESOLVED
from labhil.physics.friction_law import FASTEST, GRID, PER_OCTAVE, SLOWEST, SLOWEST_POWER
from labhil.physics.model import Model, Record
from labhil.physics.moving_part import TINY, Course, Follows, Laws, Motion, Part
from labhil.physics.terms import Enters
from labhil.signals import FloatArray

MOST = FASTEST * (1.0 - 1e-12)
"""Speed beyond which the table of a law keeps its last value."""

NODES = len(GRID)

STRAIGHT = 0.03
"""Share of the pull by which friction of one's own may leave its tangent within a step."""


class CurveArgument(IntEnum):
    """What a curve is a function of, and which way it acts."""

    TIME = 0
    """Nothing of the motion: an input, its rate, time itself. Acts along the positive direction."""
    POSITION = 1
    """Acts along the positive direction."""
    POSITION_AGAINST = 2
    """Acts against the motion, as dry friction, and adds to the hold at rest."""
    VELOCITY = 3
    """Acts along the positive direction."""
    SPEED_AGAINST = 4
    """A curve over the size of velocity, which acts against the motion; at zero it adds to the hold."""
    DAMPING = 5
    """A curve over position times the velocity, against the motion."""


def along_positive(
    acts: CurveArgument, curve: FloatArray, velocity: FloatArray, direction: FloatArray
) -> FloatArray:
    """The force along the positive direction of values of a curve (N,), at velocities (N,).

    ``direction`` (N,) is the one that dry friction acts against: sgn of the velocity, or bristles'.
    """
    if acts in (CurveArgument.POSITION_AGAINST, CurveArgument.SPEED_AGAINST):
        return np.asarray(-curve * direction)
    return np.asarray(-curve * velocity) if acts is CurveArgument.DAMPING else curve


@dataclass(frozen=True, slots=True)
class MovedPart:
    """What one more force may act on.

    ``position`` and ``velocity`` are names of coordinates, empty where recordings lack them; ``turn``
    is the period of the position, 0 where it does not repeat; ``joint`` the joint of an arm that it is.
    ``force`` and ``speed`` are its typical ones, in units of the model's yardsticks. What is added
    ``enters`` as a force, or as a difference of the output where nothing moves that a force could push.
    """

    position: str
    velocity: str
    turn: float = 0.0
    joint: int | None = None
    force: float = 1.0
    speed: float = 1.0
    enters: Enters = Enters.FORCE


class CompiledForce(NamedTuple):
    """A force over the inertia as a kernel holds it.

    ``values`` are those of the curve at ``low`` and every 1/``per_unit`` further on, straight in between and
    constant outside; ``turn`` is the period of a position that repeats (0: it does not). ``width`` is how
    far one step may go along the coordinate. ``course`` is the force from this sample to the next.
    ``friction`` are values of friction laws of one's own at the speeds of ``friction_law.GRID``, empty where
    there are none.
    """

    over: int
    low: float
    per_unit: float
    turn: float
    width: float
    values: FloatArray
    course: float
    friction: FloatArray


@dataclass(frozen=True, slots=True)
class ExtraForce:
    """A generalised force (N, N·m, or per unit of mass where the model is) beside a model's own.

    Either a curve over the simulated motion, with its values (m,) at the evenly spaced ``grid`` (m,), or a
    ``course`` (n,) along the record, constant from each sample to the next. ``turn`` is the period of a
    position that repeats, 0 where it does not; ``width`` the least width of what the curve may show. Where a
    model has several parts it acts on that of the ``joint``, and ``of`` names the coordinate of the curve.
    """

    acts: CurveArgument
    grid: FloatArray
    values: FloatArray
    width: float
    course: FloatArray | None = None
    turn: float = 0.0
    of: str = ""
    joint: int | None = None

    def over(self, inertia: float, record: Record, friction: FloatArray) -> tuple[CompiledForce, FloatArray]:
        """As a kernel takes it: the curve, and the course (n,) along a record, both over the inertia.

        ``friction`` (398,), or empty, is that of laws of one's own, over the inertia as well.
        """
        per_unit = (len(self.grid) - 1) / float(self.grid[-1] - self.grid[0])
        values = np.ascontiguousarray(self.values / inertia)
        low = float(self.grid[0])
        beyond = CompiledForce(int(self.acts), low, per_unit, self.turn, self.width, values, 0.0, friction)
        along = np.zeros(len(record)) if self.course is None else self.course / inertia
        return beyond, np.ascontiguousarray(along)


NO_FORCE = ExtraForce(CurveArgument.TIME, np.array([0.0, 1.0]), np.zeros(2), 1.0)
"""Beside which a kernel may hold friction laws of one's own."""


@runtime_checkable
class AcceptsExtraForce(Model, Protocol):
    """A model that takes one more force."""

    @property
    def force_unit(self) -> str:
        """Unit of that force."""
        ...

    @property
    def moved(self) -> tuple[MovedPart, ...]:
        """What that force may act on: the one part that moves, or every joint."""
        ...

    def with_force(self, force: ExtraForce) -> AcceptsExtraForce:
        """The same model under one more force; this one stays as it is.

        A model of several parts may be under several; the force on a single part takes the place of another.
        """
        ...


@runtime_checkable
class PositionUnobserved(AcceptsExtraForce, Protocol):
    """A model whose recordings may lack the position of its part.

    Under a force that depends on the position, each window may estimate it from its outputs.
    """

    def with_place(self) -> AcceptsExtraForce:
        """The same with the place as one more state of every window; itself where recordings have it."""
        ...


def with_place(model: AcceptsExtraForce, over: Collection[str]) -> AcceptsExtraForce:
    """The model as it takes forces ``over`` these coordinates: it has to know its place for some."""
    if not isinstance(model, PositionUnobserved):
        return model
    other = model.with_place()
    unseen = {part.position for part in other.moved} - {part.position for part in model.moved}
    return other if unseen & set(over) else model


P = TypeVar("P")
C = TypeVar("C")


class Pushed(NamedTuple, Generic[P]):
    """A part between two samples, and the force beside it."""

    part: P
    beyond: CompiledForce


class PushedCourse(NamedTuple, Generic[C]):
    """What changes along a recording, and the course (n,) of the force over the inertia."""

    course: C
    along: FloatArray


@inlined
def look_up(x: float, b: CompiledForce) -> float:
    """The curve at ``x``: straight between its nodes, constant outside."""
    if b.turn > 0.0:
        x = b.low + (x - b.low) % b.turn
    place = (x - b.low) * b.per_unit
    last = b.values.size - 1
    if not place > 0.0:
        return b.values[0]
    if place >= last:
        return b.values[last]
    k = int(place)
    share = place - k
    return (1.0 - share) * b.values[k] + share * b.values[k + 1]


@inlined
def pushes(s: Motion, b: CompiledForce) -> float:
    """What acts along the positive direction, over the inertia."""
    if b.over == 1:
        return look_up(s.x, b)
    if b.over == 5:
        return -s.v * look_up(s.x, b)
    return look_up(s.v, b) if b.over == 3 else b.course


@inlined
def rubs(s: Motion, b: CompiledForce) -> float:
    """What acts against the motion, over the inertia."""
    level = 0.0
    if b.over == 2:
        level = look_up(s.x, b)
    elif b.over == 4:
        level = look_up(abs(s.v), b)
    return level + friction_at(abs(s.v), b.friction, 0) if b.friction.size else level


@inlined
def cell_of(speed: float) -> tuple[int, float]:
    """The cell of ``friction_law.GRID`` in which a speed is, and the share of it behind."""
    if not speed > SLOWEST:
        return 0, speed / SLOWEST
    # half to one times a power of two; the octave below that power begins at twice the half
    part, power = math.frexp(min(speed, MOST))
    place = (2.0 * part - 1.0) * PER_OCTAVE
    k = int(place)
    return 1 + (power - 1 - SLOWEST_POWER) * PER_OCTAVE + k, place - k


@inlined
def friction_at(speed: float, values: FloatArray, first: int) -> float:
    """A table over ``friction_law.GRID`` that begins at ``first``: straight between its nodes."""
    k, share = cell_of(speed)
    low = values[first + k]
    return low + (values[first + k + 1] - low) * share


@inlined
def friction_pace(speed: float, rate: float, values: FloatArray, first: int) -> float:
    """How long one step may be (s) at acceleration ``rate``: short against how the table damps and bends."""
    k, _ = cell_of(speed)
    slope = cell_slope(values, first, k)
    bend = abs(cell_slope(values, first, min(k + PER_OCTAVE, NODES - 2)) - slope)
    pull = abs(rate) + TINY
    reach = max(RESOLVED * (speed + SLOWEST), STRAIGHT * pull / (bend + TINY))
    return min(reach / pull, RESOLVED / (abs(slope) + TINY))


@inlined
def cell_slope(values: FloatArray, first: int, k: int) -> float:
    """How fast a table that begins at ``first`` rises in cell ``k`` of ``friction_law.GRID``."""
    width = math.ldexp(SLOWEST / PER_OCTAVE, (k - 1) // PER_OCTAVE) if k > 0 else SLOWEST
    return (values[first + k + 1] - values[first + k]) / width


Pull = Callable[[Motion, float, float, Part], float]


def with_extra(laws: Laws[Part, Course]) -> Laws[Pushed[Part], PushedCourse[Course]]:
    """The laws of the same part under one more force."""
    pull, target, follow, settled, grip, pace, damping, at = laws

    @specialised
    def extra_pull(s: Motion, side: float, u: float, p: Pushed[Part]) -> float:
        return pull(s, side, u, p.part) + pushes(s, p.beyond) - side * rubs(s, p.beyond)

    @specialised
    def extra_target(s: Motion, u: float, how: Follows, p: Pushed[Part]) -> float:
        return target(s, u, how, p.part)

    @specialised
    def extra_follow(s: Motion, p: Pushed[Part]) -> Follows:
        return follow(s, p.part)

    @specialised
    def extra_settled(s: Motion, u: float, p: Pushed[Part]) -> float:
        return settled(s, u, p.part)

    @specialised
    def extra_grip(s: Motion, u: float, p: Pushed[Part]) -> tuple[float, float]:
        drive, level = grip(s, u, p.part)
        return drive + pushes(s, p.beyond), max(level + rubs(s, p.beyond), 0.0)

    @specialised
    def extra_pace(
        s: Motion, side: float, u: float, rise: float, since: float, how: Follows, finest: float,
        p: Pushed[Part],
    ) -> float:  # fmt: skip
        size = pace(s, side, u, rise, since, how, finest, p.part)
        b = p.beyond
        if side == 0.0 or (b.over == 0 and not b.friction.size):
            return size
        pulled = extra_pull(s, side, u, p)
        if b.friction.size:
            size = min(size, max(friction_pace(abs(s.v), pulled, b.friction, 0), finest))
        if b.over == 0:
            return size
        rate = pulled if 3 <= b.over <= 4 else s.v
        return min(size, max(b.width / (abs(rate) + TINY), finest))

    @specialised
    def extra_damping(s: Motion, side: float, p: Pushed[Part]) -> tuple[float, float]:
        # what depends on velocity damps as well: such a part does not count as creeping
        if p.beyond.over >= 3 or p.beyond.friction.size:
            return 0.0, 0.0
        return damping(s, side, p.part)

    @specialised
    def extra_at(p: Pushed[Part], c: PushedCourse[Course], k: int) -> Pushed[Part]:
        b = p.beyond
        force = CompiledForce(b.over, b.low, b.per_unit, b.turn, b.width, b.values, c.along[k], b.friction)
        return Pushed(at(p.part, c.course, k), force)

    return Laws(
        extra_pull, extra_target, extra_follow, extra_settled, extra_grip, extra_pace, extra_damping, extra_at
    )
