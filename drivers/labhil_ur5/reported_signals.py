"""Signals of a UR arm and the controller's variables that they come from."""

from __future__ import annotations

from dataclasses import dataclass

from labhil.kinds import JOINTS, UR5
from labhil.signals import Direction, Hold, Signal

_KIND_SIGNALS = {signal.name: signal for signal in UR5.signals()}


@dataclass(frozen=True, slots=True)
class ReportedSignal:
    """A signal and the variable that it comes from.

    Attributes:
        signal: The signal.
        variable: The name of the controller's variable.
        optional: Whether the controller may not know it; the signal is NaN then.
        mask: Bits of the word that belong to the signal; 0 for all.
    """

    signal: Signal
    variable: str
    optional: bool = False
    mask: int = 0


def _kind_signal(name: str, optional: bool = False) -> ReportedSignal:
    return ReportedSignal(_KIND_SIGNALS[name], name, optional)


def _status_signal(
    name: str, unit: str, description: str, variable: str = "", mask: int = 0
) -> ReportedSignal:
    signal = Signal(name, unit, Direction.STATUS, hold=Hold.ZERO, description=description)
    return ReportedSignal(signal, variable or name, optional=name not in REQUIRED_STATUS, mask=mask)


COMMAND_TIMEOUT = 0.3
"""Time without a command after which the arm stops, s."""
DIGITAL_OUTPUTS = 8
TIMESTAMP = "timestamp"
"""The variable of the controller's clock, s."""
REQUIRED_STATUS = ("safety_mode", "runtime_state")
"""Status that decides whether the arm may be moved."""

REPORTED: tuple[ReportedSignal, ...] = (
    *(_kind_signal(name) for name in ("actual_q", "actual_qd", "actual_current")),
    *(
        _kind_signal(name)
        for name in ("target_q", "target_qd", "target_qdd", "target_current", "target_moment")
    ),
    _kind_signal("joint_temperatures", optional=True),
    _kind_signal("actual_main_voltage", optional=True),
    _status_signal("actual_robot_voltage", "V", "of the arm's supply"),
    _status_signal("actual_robot_current", "A", "that the arm draws"),
    _status_signal("robot_mode", "", "7 running; see the RTDE guide"),
    _status_signal(
        "safety_mode", "", "1 normal, 2 reduced, 3 protective stop, 6 and 7 emergency stop, 9 fault"
    ),
    _status_signal("robot_status_bits", "", "bit 0 power on, bit 1 program running"),
    _status_signal("safety_status_bits", "", "bit 0 normal, bit 2 protective stop, bit 7 emergency stop"),
    _status_signal("runtime_state", "", "1 stopped, 2 playing, 4 paused"),
    _status_signal("speed_scaling", "", "share of the programmed speed that is in effect"),
    _status_signal("target_speed_fraction", "", "where the speed slider stands, 0 to 1"),
    _status_signal(
        "standard_digital_outputs", "", "the eight of them as a number", "actual_digital_output_bits", 255
    ),
)

CLIENT = Signal(
    "client_state",
    "",
    Direction.STATUS,
    hold=Hold.ZERO,
    description="0 nobody commands the arm, 1 starting, 2 ready, 3 moveJ, 4 along a path, 5 stopping",
)
"""State of the client process; it is not a variable of the controller."""

TARGET = _KIND_SIGNALS["target_q"]
SPEED = next(item.signal for item in REPORTED if item.signal.name == "target_speed_fraction")
OUTPUTS = next(item.signal for item in REPORTED if item.signal.name == "standard_digital_outputs")

TARGET_COLUMNS = TARGET.columns()
assert len(TARGET_COLUMNS) == JOINTS
