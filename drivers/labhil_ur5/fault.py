"""Faults that prevent commands to an arm, as text."""

from __future__ import annotations

import math
from collections.abc import Mapping

SAFETY_NORMAL = (1.0, 2.0)
"""Normal and reduced."""
ROBOT_RUNNING = 7.0

SAFETY_MODES = {
    3: "protective stop: something resisted the arm or its limits were exceeded; look at it, then release"
    " the stop on the pendant",
    4: "recovery: a joint is outside its safety limits; move it back by hand from the pendant",
    5: "safeguard stop: a safeguard input is open",
    6: "emergency stop by the system's input",
    7: "emergency stop by a button on the robot",
    8: "violation of the safety system",
    9: "fault of the safety system; the controller has to be started again",
    10: "the safety system is being set up: joint ids do not match",
    11: "the safety system is being set up",
    12: "safeguard stop in automatic mode",
    13: "safeguard stop by the three-position enabling device",
}
ROBOT_MODES = {
    -1: "it is not connected to its controller",
    0: "disconnected",
    1: "the safety settings wait to be confirmed",
    2: "booting",
    3: "powered off",
    4: "powered on, not yet brought to run",
    5: "idle: its brakes are still on",
    6: "back-drive",
    8: "its firmware is being updated",
}


def fault_of(latest: Mapping[str, float], commanded: bool) -> str:
    """Return the fault of an arm as text; empty without one.

    Args:
        latest: The latest values of its signals.
        commanded: Whether the driver commands the arm; otherwise it may be off or moved by hand.
    """
    safety = latest.get("safety_mode", SAFETY_NORMAL[0])
    if safety not in SAFETY_NORMAL:
        return f"{SAFETY_MODES.get(int(safety), 'not normal')} (safety_mode {safety:g})"
    robot = latest.get("robot_mode", ROBOT_RUNNING)
    if commanded and robot != ROBOT_RUNNING and not math.isnan(robot):
        return f"the arm does not run: {ROBOT_MODES.get(int(robot), 'unknown mode')} (robot_mode {robot:g})"
    return ""
