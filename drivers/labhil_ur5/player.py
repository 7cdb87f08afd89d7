"""Interpolation of waypoints to servo targets: a smooth path in joint space that ends at known waypoints.

Waypoints have times of the controller's clock. Between them the path is a cubic whose slopes are those of
parabolas through three neighbours; it is played with a delay behind the newest waypoint. Without new
waypoints it slows down and comes to rest on the path, and continues when they arrive. So neither a stall of a
process nor a stop causes a jump, and a stop stays on the path.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

Joints = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PathOptions:
    """How a path is played.

    Attributes:
        delay: time by which the path is played behind the newest waypoint, s.
        slowing: remaining time of the path below which it slows down, s: from 1 rad/s with at most 7 rad/s².
        stopping_time: duration of a stop, s: from 1 rad/s with 3.3 rad/s².
        max_catch_up: largest relative excess of the playing rate that restores ``delay``.
        blending_time: time in which a small distance between arm and first waypoint is closed, s.
        max_tick: largest time of a tick, s: after a stall the path continues where it was.
        max_speed: largest speed of a joint, rad/s; a UR5 reaches 180°/s.
    """

    delay: float = 0.2
    slowing: float = 0.15
    stopping_time: float = 0.3
    max_catch_up: float = 0.1
    blending_time: float = 0.5
    max_tick: float = 0.02
    max_speed: float = 3.2


DEFAULT_OPTIONS = PathOptions()


class TooFastError(Exception):
    """Waypoints exceed the speed of a joint."""


class Player:
    """Plays one path.

    Args:
        begin: Position of the arm, rad, near the first waypoint.
        t: Time of the first waypoint, s.
        q: The first waypoint, rad.
        options: How the path is played.
    """

    def __init__(
        self, begin: Sequence[float], t: float, q: Sequence[float], options: PathOptions = DEFAULT_OPTIONS
    ) -> None:
        self._options = options
        self._points: deque[tuple[float, Joints]] = deque([(t, tuple(q))])
        self._offset = tuple(a - b for a, b in zip(begin, q, strict=True))
        self._blend = 0.0
        self._t = t
        self._rate = 0.0
        self._mean_remaining = self._options.delay
        self._playing = False
        self._stopping = False
        self._target: Joints = tuple(begin)

    def add(self, t: float, q: Sequence[float]) -> None:
        """Add a waypoint; one that is not later than the newest is ignored.

        Raises:
            TooFastError: It cannot be reached in time.
        """
        last_t, last_q = self._points[-1]
        if t <= last_t or self._stopping:
            return
        joint, fastest = max(
            enumerate(abs(b - a) / (t - last_t) for a, b in zip(last_q, q, strict=True)), key=lambda it: it[1]
        )
        if fastest > self._options.max_speed:
            raise TooFastError(
                f"the path asks joint {joint} for {fastest:.3g} rad/s; at most "
                f"{self._options.max_speed:g} rad/s are allowed"
            )
        self._points.append((t, tuple(q)))

    def stop(self) -> None:
        """Come to rest on the path, and hold."""
        self._stopping = True

    @property
    def at_rest(self) -> bool:
        """Whether a stop has ended."""
        return self._stopping and self._rate <= 0.0

    def tick(self, elapsed: float) -> Joints:
        """Return the target of the joints, rad, ``elapsed`` s after the previous tick."""
        dt = min(elapsed, self._options.max_tick)
        # the slope at the newest waypoint is unknown until the next arrives: the path ends one earlier
        path_end = self._points[-2 if len(self._points) > 1 else -1][0]
        remaining = path_end - self._t
        self._playing = self._playing or remaining >= self._options.delay
        if self._playing:
            self._rate = self._next_rate(remaining, dt)
            self._t = min(self._t + self._rate * dt, path_end)
        self._blend = min(self._blend + dt / self._options.blending_time, 1.0)
        share = 1.0 - _smoothstep(self._blend)
        self._target = tuple(a + share * b for a, b in zip(self._path(), self._offset, strict=True))
        return self._target

    def _next_rate(self, remaining: float, dt: float) -> float:
        # a mean over a second, since waypoints arrive one by one
        self._mean_remaining += dt * (remaining - self._mean_remaining)
        rate = 1.0 + max(
            -self._options.max_catch_up,
            min(self._options.max_catch_up, self._mean_remaining - self._options.delay),
        )
        if remaining < self._options.slowing:
            rate = min(rate, remaining / self._options.slowing)
        step = dt / self._options.stopping_time
        if self._stopping:
            rate = min(rate, self._rate - step)
        rate = max(rate, self._rate - 2.0 * dt / self._options.slowing)
        return max(0.0, min(rate, self._rate + step))

    def _path(self) -> Joints:
        points = self._points
        while len(points) > 3 and points[2][0] <= self._t:
            points.popleft()
        neighbours = list(islice(points, 4))
        index = 1 if len(neighbours) > 2 and neighbours[1][0] <= self._t else 0
        if len(neighbours) < 2:
            return neighbours[0][1]
        (t0, q0), (t1, q1) = neighbours[index], neighbours[index + 1]
        span = t1 - t0
        u = (self._t - t0) / span
        slope0 = _slope(neighbours, index)
        slope1 = _slope(neighbours, index + 1)
        position_weight, slope_weight = u * u * (3.0 - 2.0 * u), u * (1.0 - u) * span
        return tuple(
            a + position_weight * (b - a) + slope_weight * ((1.0 - u) * da - u * db)
            for a, b, da, db in zip(q0, q1, slope0, slope1, strict=True)
        )


def _slope(points: Sequence[tuple[float, Joints]], index: int) -> Joints:
    """Slope of the parabola through a point and its neighbours, or of the line where there is only one."""
    if index in (0, len(points) - 1):
        (ta, qa), (tb, qb) = points[:2] if index == 0 else points[-2:]
        return tuple((b - a) / (tb - ta) for a, b in zip(qa, qb, strict=True))
    t, q = points[index]
    before, after = points[index - 1], points[index + 1]
    h0, h1 = t - before[0], after[0] - t
    return tuple(
        ((b - a) / h0 * h1 + (c - b) / h1 * h0) / (h0 + h1)
        for a, b, c in zip(before[1], q, after[1], strict=True)
    )


def _smoothstep(u: float) -> float:
    """Quintic from 0 to 1 with zero velocity and acceleration at both ends."""
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))
