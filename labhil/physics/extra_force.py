"""An additional, nonparametric force on a moving part: a curve along its motion, or a course over time.

:func:`with_extra_force` extends the laws of any moving part (``physics.moving_part``) by one force; a kernel
without it is unchanged. A curve is a table over the simulated position or velocity, never over the measured
one: a force that depends on the measurement would pull the simulation towards it (a stiff spring to the
measured position explains any record).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from labhil.compiled import inlined, specialised
from labhil.physics.friction import MAX_STEP_SHARE
from labhil.physics.friction_law import FASTEST, GRID, PER_OCTAVE, SLOWEST, SLOWEST_POWER
from labhil.physics.model import Model
from labhil.physics.moving_part import TINY, Course, Follows, Laws, Motion, Part
from labhil.physics.record import Record
from labhil.physics.terms import Enters
from labhil.signals import FloatArray

MAX_SPEED = FASTEST * (1.0 - 1e-12)
"""Speed above which the table of a law keeps its last value, m/s or rad/s."""

N_NODES = len(GRID)

MAX_DEVIATION_FROM_TANGENT = 0.03
"""Largest deviation of tabulated friction from its tangent within a step, as a share of the acceleration."""


class CurveArgument(IntEnum):
    """The argument of a curve, and the direction in which the force acts."""

    TIME = 0
    """Not the motion: an input, its rate, or time. Acts along the positive direction."""
    POSITION = 1
    """Acts along the positive direction."""
    POSITION_AGAINST = 2
    """Over position; acts against the motion as dry friction and adds to the break-away force."""
    VELOCITY = 3
    """Acts along the positive direction."""
    SPEED_AGAINST = 4
    """Over speed; acts against the motion, and its value at zero adds to the break-away force."""
    DAMPING = 5
    """Over position: a damping coefficient. The force is curve times velocity, against the motion."""


def along_positive(
    acts: CurveArgument, curve: FloatArray, velocity: FloatArray, direction: FloatArray
) -> FloatArray:
    """Convert values of a curve to the force along the positive direction.

    Args:
        acts: Argument and direction of the curve.
        curve: Its values, (N,).
        velocity: Velocities, (N,).
        direction: Direction of dry friction from −1 to 1, (N,): sign of the velocity, or of bristles.

    Returns:
        The force, (N,).
    """
    if acts in (CurveArgument.POSITION_AGAINST, CurveArgument.SPEED_AGAINST):
        return np.asarray(-curve * direction)
    return np.asarray(-curve * velocity) if acts is CurveArgument.DAMPING else curve


@dataclass(frozen=True, slots=True)
class MovedPart:
    """A part on which an additional force may act.

    Attributes:
        position: Coordinate of its position, "" if recordings lack it.
        velocity: Coordinate of its velocity, "" if recordings lack it.
        turn: Period of the position, 0 if it is not periodic.
        joint: Joint of an arm, from 0.
        force: Typical force in units of the model's characteristic scales.
        speed: Typical speed in units of the model's characteristic scales.
        enters: As a force, or as a difference of the output where no simulated part moves.
    """

    position: str
    velocity: str
    turn: float = 0.0
    joint: int | None = None
    force: float = 1.0
    speed: float = 1.0
    enters: Enters = Enters.FORCE


class CompiledForce(NamedTuple):
    """An additional force over the inertia as a kernel holds it.

    Attributes:
        over: The :class:`CurveArgument` as a number.
        low: Coordinate of the first value of the curve.
        per_unit: Values per unit of the coordinate; the curve is linear in between and constant outside.
        turn: Period of the position, 0 if it is not periodic.
        width: Longest way of one step along the coordinate.
        values: Values of the curve.
        course: The force from this sample to the next.
        friction: User-defined friction at the speeds of ``friction_law.GRID``; empty if there is none.
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
    """An additional generalised force, N or N·m (or per unit of mass where the model is).

    Either a curve over the simulated motion, or a course over time.

    Attributes:
        acts: Argument and direction of the curve.
        grid: Evenly spaced coordinates of the curve, (m,).
        values: Force at these coordinates, (m,).
        width: Least width of a feature of the curve, in the unit of the coordinate.
        course: Force at each sample of the record, (n,), constant until the next; None for a curve.
        turn: Period of the position, 0 if it is not periodic.
        of: Coordinate of the curve in a model of several parts.
        joint: Joint on which it acts in a model of several parts.
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
        """Convert to the form that a kernel takes: the curve and the course (n,), over the inertia.

        ``friction`` (398,) is user-defined friction over the inertia, or empty.
        """
        per_unit = (len(self.grid) - 1) / float(self.grid[-1] - self.grid[0])
        values = np.ascontiguousarray(self.values / inertia)
        low = float(self.grid[0])
        force = CompiledForce(int(self.acts), low, per_unit, self.turn, self.width, values, 0.0, friction)
        along = np.zeros(len(record)) if self.course is None else self.course / inertia
        return force, np.ascontiguousarray(along)


NO_FORCE = ExtraForce(CurveArgument.TIME, np.array([0.0, 1.0]), np.zeros(2), 1.0)
"""Zero force, for a kernel that holds user-defined friction only."""


@runtime_checkable
class AcceptsExtraForce(Model, Protocol):
    """A model that accepts an additional force."""

    @property
    def force_unit(self) -> str:
        """Unit of that force."""
        ...

    @property
    def moved(self) -> tuple[MovedPart, ...]:
        """The parts on which that force may act: the moving part, or every joint."""
        ...

    def with_force(self, force: ExtraForce) -> AcceptsExtraForce:
        """Copy of the model with an additional force.

        A model of several parts keeps the forces that it has; on a single part the force replaces another.
        """
        ...


@runtime_checkable
class PositionUnobserved(AcceptsExtraForce, Protocol):
    """A model whose recordings may lack the position of its moving part.

    With a force that depends on the position, each window may estimate its initial position.
    """

    def with_place(self) -> AcceptsExtraForce:
        """Copy with the position as one more state of every window; the model itself if it is recorded."""
        ...


def with_place(model: AcceptsExtraForce, over: Collection[str]) -> AcceptsExtraForce:
    """Add the position to the states if a force ``over`` one of these coordinates needs it."""
    if not isinstance(model, PositionUnobserved):
        return model
    other = model.with_place()
    unseen = {part.position for part in other.moved} - {part.position for part in model.moved}
    return other if unseen & set(over) else model


P = TypeVar("P")
C = TypeVar("C")


class Pushed(NamedTuple, Generic[P]):
    """A part between two samples, and the additional force on it."""

    part: P
    force: CompiledForce


class PushedCourse(NamedTuple, Generic[C]):
    """What changes along a recording, and the course (n,) of the force over the inertia."""

    course: C
    along: FloatArray


@inlined
def look_up(x: float, b: CompiledForce) -> float:
    """Value of the curve at ``x``: linear between its nodes, constant outside."""
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
def push(s: Motion, b: CompiledForce) -> float:
    """Force along the positive direction, over the inertia."""
    if b.over == 1:
        return look_up(s.x, b)
    if b.over == 5:
        return -s.v * look_up(s.x, b)
    return look_up(s.v, b) if b.over == 3 else b.course


@inlined
def drag(s: Motion, b: CompiledForce) -> float:
    """Force against the motion, over the inertia."""
    level = 0.0
    if b.over == 2:
        level = look_up(s.x, b)
    elif b.over == 4:
        level = look_up(abs(s.v), b)
    return level + friction_at(abs(s.v), b.friction, 0) if b.friction.size else level


@inlined
def cell_of(speed: float) -> tuple[int, float]:
    """Cell of ``friction_law.GRID`` that contains a speed, and the relative position in it."""
    if not speed > SLOWEST:
        return 0, speed / SLOWEST
    # half to one times a power of two; the octave below that power begins at twice the half
    part, power = math.frexp(min(speed, MAX_SPEED))
    place = (2.0 * part - 1.0) * PER_OCTAVE
    k = int(place)
    return 1 + (power - 1 - SLOWEST_POWER) * PER_OCTAVE + k, place - k


@inlined
def friction_at(speed: float, values: FloatArray, first: int) -> float:
    """Value of a table over ``friction_law.GRID`` that begins at ``first``: linear between its nodes."""
    k, share = cell_of(speed)
    low = values[first + k]
    return low + (values[first + k + 1] - low) * share


@inlined
def max_table_step(speed: float, rate: float, values: FloatArray, first: int) -> float:
    """Longest step at acceleration ``rate``, s: short against the slope and curvature of the table."""
    k, _ = cell_of(speed)
    slope = cell_slope(values, first, k)
    bend = abs(cell_slope(values, first, min(k + PER_OCTAVE, N_NODES - 2)) - slope)
    pull = abs(rate) + TINY
    reach = max(MAX_STEP_SHARE * (speed + SLOWEST), MAX_DEVIATION_FROM_TANGENT * pull / (bend + TINY))
    return min(reach / pull, MAX_STEP_SHARE / (abs(slope) + TINY))


@inlined
def cell_slope(values: FloatArray, first: int, k: int) -> float:
    """Slope of a table that begins at ``first`` in cell ``k`` of ``friction_law.GRID``."""
    width = math.ldexp(SLOWEST / PER_OCTAVE, (k - 1) // PER_OCTAVE) if k > 0 else SLOWEST
    return (values[first + k + 1] - values[first + k]) / width


MaxStep = Callable[[Motion, float, float, float, float, Follows, float, Part], float]
"""The law :attr:`physics.moving_part.Laws.max_step`."""


def _compile_max_step(
    max_step: MaxStep[Part], acceleration: Callable[[Motion, float, float, Pushed[Part]], float]
) -> MaxStep[Pushed[Part]]:
    """Compile the longest step of a part under an additional force, with which it has ``acceleration``."""

    @specialised
    def extra_max_step(
        s: Motion, side: float, u: float, rise: float, since: float, lag: Follows, finest: float,
        p: Pushed[Part],
    ) -> float:  # fmt: skip
        size = max_step(s, side, u, rise, since, lag, finest, p.part)
        b = p.force
        if side == 0.0 or (b.over == 0 and not b.friction.size):
            return size
        pulled = acceleration(s, side, u, p)
        if b.friction.size:
            size = min(size, max(max_table_step(abs(s.v), pulled, b.friction, 0), finest))
        if b.over == 0:
            return size
        rate = pulled if 3 <= b.over <= 4 else s.v
        return min(size, max(b.width / (abs(rate) + TINY), finest))

    return extra_max_step


def with_extra_force(laws: Laws[Part, Course]) -> Laws[Pushed[Part], PushedCourse[Course]]:
    """Extend the laws of a part by an additional force.

    Args:
        laws: Laws of the part.

    Returns:
        Laws of the same part, as :class:`Pushed`, with the force.
    """
    (
        acceleration, target, follow, steady_value, pull_and_hold, max_step, damping, part_at, bend_after,
        first_bend,
    ) = laws  # fmt: skip

    @specialised
    def extra_acceleration(s: Motion, side: float, u: float, p: Pushed[Part]) -> float:
        return acceleration(s, side, u, p.part) + push(s, p.force) - side * drag(s, p.force)

    @specialised
    def extra_target(s: Motion, u: float, lag: Follows, p: Pushed[Part]) -> float:
        return target(s, u, lag, p.part)

    @specialised
    def extra_follow(s: Motion, u: float, p: Pushed[Part]) -> Follows:
        return follow(s, u, p.part)

    @specialised
    def extra_steady_value(s: Motion, u: float, p: Pushed[Part]) -> float:
        return steady_value(s, u, p.part)

    @specialised
    def extra_pull_and_hold(s: Motion, u: float, p: Pushed[Part]) -> tuple[float, float]:
        drive, level = pull_and_hold(s, u, p.part)
        return drive + push(s, p.force), max(level + drag(s, p.force), 0.0)

    extra_max_step = _compile_max_step(max_step, extra_acceleration)

    @specialised
    def extra_damping(s: Motion, side: float, p: Pushed[Part]) -> tuple[float, float]:
        # a force that depends on velocity damps too, so such a part does not count as creeping
        if p.force.over >= 3 or p.force.friction.size:
            return 0.0, 0.0
        return damping(s, side, p.part)

    @specialised
    def extra_part_at(p: Pushed[Part], c: PushedCourse[Course], k: int) -> Pushed[Part]:
        b = p.force
        force = CompiledForce(b.over, b.low, b.per_unit, b.turn, b.width, b.values, c.along[k], b.friction)
        return Pushed(part_at(p.part, c.course, k), force)

    @specialised
    def extra_bend_after(bend: float, side: float, way: float, p: Pushed[Part]) -> float:
        return bend_after(bend, side, way, p.part)

    @specialised
    def extra_first_bend(s: Motion, u: float, p: Pushed[Part]) -> float:
        return first_bend(s, u, p.part)

    return Laws(
        extra_acceleration, extra_target, extra_follow, extra_steady_value, extra_pull_and_hold,
        extra_max_step, extra_damping, extra_part_at, extra_bend_after, extra_first_bend,
    )  # fmt: skip
