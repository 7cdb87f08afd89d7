"""Waypoints in, servo targets out: a smooth path in joint space that never runs ahead of what is known.

Waypoints bear times of the controller's clock. Between them the path is a cubic whose slopes are those of
parabolas through three neighbours; it is played about ``DELAY`` behind the newest waypoint. When
waypoints stay away it slows down and comes to rest on the path itself, and goes on when they are back.
So neither a stall of any process nor a stop makes a jump, and a stop leaves the path nowhere.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import islice

Joints = tuple[float, ...]

DELAY = 0.2
"""How far behind the newest waypoint the path is played, s."""
SLOWING = 0.15
"""With less than this left to play the path slows down, s: from 1 rad/s with at most 7 rad/s²."""
STOPPING_TIME = 0.3
"""How long a stop takes, s: from 1 rad/s with 3.3 rad/s²."""
CATCHING_UP = 0.1
"""By how much the path may be played too fast, to come back to ``DELAY``."""
BLENDING_TIME = 0.5
"""In what time a small distance between the arm and the first waypoint is closed, s."""
LONGEST_TICK = 0.02
"""What a tick may count for, s: after a stall the path goes on where it was."""
FASTEST = 3.2
"""The speed that no joint may exceed, rad/s: a UR5 reaches 180°/s."""


class TooFastError(Exception):
    """Waypoints ask for more than a joint can do."""


class Player:
    """Plays one path from its first waypoint; the arm stands at ``begin`` (rad), which is near it."""

    def __init__(self, begin: Sequence[float], t: float, q: Sequence[float]) -> None:
        self._points: deque[tuple[float, Joints]] = deque([(t, tuple(q))])
        self._offset = tuple(a - b for a, b in zip(begin, q, strict=True))
        self._blended = 0.0
        self._t = t
        self._rate = 0.0
        self._ahead = DELAY
        self._playing = False
        self._stopping = False
        self._target: Joints = tuple(begin)

    def take(self, t: float, q: Sequence[float]) -> None:
        """Take a waypoint in; one that is not later than the newest is old and left out.

        TooFastError when it cannot be reached in time.
        """
        last_t, last_q = self._points[-1]
        if t <= last_t or self._stopping:
            return
        joint, fastest = max(
            enumerate(abs(b - a) / (t - last_t) for a, b in zip(last_q, q, strict=True)), key=lambda it: it[1]
        )
        if fastest > FASTEST:
            raise TooFastError(
                f"the path asks joint {joint} for {fastest:.3g} rad/s; at most {FASTEST:g} rad/s are allowed"
            )
        self._points.append((t, tuple(q)))

    def stop(self) -> None:
        """Come to rest on the path, and stay there."""
        self._stopping = True

    @property
    def at_rest(self) -> bool:
        """Whether a stop has ended."""
        return self._stopping and self._rate <= 0.0

    def tick(self, elapsed: float) -> Joints:
        """Return where the joints are to be, ``elapsed`` s after the tick before."""
        dt = min(elapsed, LONGEST_TICK)
        # the slope at the newest waypoint is not known before the next: the path ends one earlier
        path_end = self._points[-2 if len(self._points) > 1 else -1][0]
        remaining = path_end - self._t
        self._playing = self._playing or remaining >= DELAY
        if self._playing:
            self._rate = self._next_rate(remaining, dt)
            self._t = min(self._t + self._rate * dt, path_end)
        self._blended = min(self._blended + dt / BLENDING_TIME, 1.0)
        share = 1.0 - _smooth(self._blended)
        self._target = tuple(a + share * b for a, b in zip(self._path(), self._offset, strict=True))
        return self._target

    def _next_rate(self, remaining: float, dt: float) -> float:
        # the mean over a second, for waypoints come one by one
        self._ahead += dt * (remaining - self._ahead)
        rate = 1.0 + max(-CATCHING_UP, min(CATCHING_UP, self._ahead - DELAY))
        if remaining < SLOWING:
            rate = min(rate, remaining / SLOWING)
        step = dt / STOPPING_TIME
        if self._stopping:
            rate = min(rate, self._rate - step)
        rate = max(rate, self._rate - 2.0 * dt / SLOWING)
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
        rise, bend = u * u * (3.0 - 2.0 * u), u * (1.0 - u) * span
        return tuple(
            a + rise * (b - a) + bend * ((1.0 - u) * da - u * db)
            for a, b, da, db in zip(q0, q1, slope0, slope1, strict=True)
        )


def _slope(points: Sequence[tuple[float, Joints]], index: int) -> Joints:
    """The slope of the parabola through a point and its neighbours; of the line where there is but one."""
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


def _smooth(u: float) -> float:
    """From 0 to 1 with velocity and acceleration zero at both ends."""
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))
