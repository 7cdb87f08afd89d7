"""Numbers of the controller's states."""

from __future__ import annotations

from enum import IntEnum


class Runtime(IntEnum):
    """``runtime_state``: the state of the program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class RobotMode(IntEnum):
    """``robot_mode``."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7


class SafetyMode(IntEnum):
    """``safety_mode``; its bit in ``safety_status_bits`` is its number minus one."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    EMERGENCY_STOP = 7
    """By the robot's own button."""


JOINT_MODE = {
    RobotMode.POWER_OFF: 239,
    RobotMode.POWER_ON: 247,
    RobotMode.IDLE: 255,
    RobotMode.BACKDRIVE: 238,
    RobotMode.RUNNING: 253,
}
"""``joint_mode`` of all six."""

SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}
"""``safety_status_bits``."""

POWER_ON, PROGRAM_RUNNING, POWER_BUTTON = 1 << 0, 1 << 1, 1 << 3
"""Bits of ``robot_status_bits``."""
