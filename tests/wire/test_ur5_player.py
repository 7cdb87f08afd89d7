"""The path that an arm is sent along: smooth, on its waypoints, never ahead of them."""

import math
import random

import numpy as np
import pytest

from labhil_ur5.player import DEFAULT_OPTIONS, Player, TooFastError

DT, PERIOD = 0.002, 0.01


def path(t):
    return (0.4 * math.sin(2 * t) ** 2, -1.0 + 0.3 * math.sin(t) * math.sin(3 * t))


def played(waypoints, seconds, stop_at=math.inf):
    """Targets at 500 Hz; ``waypoints`` are (when they come, t) and belong to ``path``."""
    (_, first), *rest = waypoints
    player = Player(path(first), first, path(first))
    targets = []
    for tick in range(round(seconds / DT)):
        now = tick * DT
        while rest and rest[0][0] <= now:
            player.add(rest[0][1], path(rest.pop(0)[1]))
        if now >= stop_at:
            player.stop()
        targets.append(player.tick(DT))
    return np.array(targets), player


def even(seconds, late=lambda k: 0.0):
    return [(k * PERIOD + late(k), k * PERIOD) for k in range(round(seconds / PERIOD))]


def test_the_path_goes_through_its_waypoints_as_smoothly_as_it_is_meant_to_be() -> None:
    jitter = random.Random(1)
    targets, _ = played(even(10.0, lambda k: jitter.uniform(0.0, 0.03)), 9.0)
    dense = np.array([path(t) for t in np.arange(0.0, 10.0, 5e-4)])
    distance = [np.min(np.max(np.abs(dense - q), axis=1)) for q in targets[::101]]
    assert max(distance) < 8e-4
    # the greatest acceleration of the path itself is 4.7; at the start the clock's ramp adds to it
    assert np.abs(np.diff(targets[500:], n=2, axis=0)).max() / DT**2 < 8.0
    assert np.abs(np.diff(targets, axis=0)).max() / DT < 1.1 * DEFAULT_OPTIONS.max_speed / 3


def test_waypoints_that_stay_away_bring_it_to_rest_on_the_path_and_it_goes_on_after() -> None:
    waypoints = [(come if t < 3.0 else come + 0.6, t) for come, t in even(8.0)]
    targets, _ = played(waypoints, 8.0)
    speed = np.abs(np.diff(targets, axis=0)).max(axis=1) / DT
    assert speed[round(3.5 / DT) : round(3.55 / DT)].max() < 0.1
    assert speed[round(4.0 / DT) :].max() > 0.3
    assert np.abs(np.diff(targets, n=2, axis=0)).max() / DT**2 < 12.0
    on = np.array([path(t) for t in np.arange(0.0, 8.0, 5e-4)])
    assert max(np.min(np.max(np.abs(on - q), axis=1)) for q in targets[::101]) < 8e-4


def test_a_stop_ends_at_rest_on_the_path() -> None:
    targets, player = played(even(5.0), 5.0, stop_at=2.0)
    assert player.at_rest
    assert np.all(targets[-1] == targets[round(2.4 / DT)])
    assert np.abs(np.diff(targets, n=2, axis=0)).max() / DT**2 < 12.0


def test_it_waits_until_enough_is_known_and_stands_until_then() -> None:
    targets, _ = played([(0.0, 0.0)], 1.0)
    assert np.all(targets == targets[0])
    targets, _ = played(even(1.0), DEFAULT_OPTIONS.delay - 0.02)
    assert np.all(targets == targets[0])


def test_a_small_distance_to_the_first_waypoint_is_closed_without_a_step() -> None:
    player = Player((0.001, 0.0), 0.0, (0.0, 0.0))
    targets = np.array([player.tick(DT) for _ in range(500)])
    assert np.abs(np.diff(targets, axis=0)).max() < 1e-5
    assert tuple(targets[0]) == pytest.approx((0.001, 0.0), abs=1e-6)
    assert tuple(targets[-1]) == (0.0, 0.0)


def test_what_no_joint_can_do_is_refused() -> None:
    player = Player((0.0, 0.0), 0.0, (0.0, 0.0))
    with pytest.raises(TooFastError, match="joint 1 for 50 rad/s"):
        player.add(0.01, (0.0, 0.5))
