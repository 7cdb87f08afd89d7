"""What an arm's controller reports and takes: each quantity once, with its name on the wire."""

from __future__ import annotations

from dataclasses import dataclass

from labhil.kinds import JOINTS, UR5
from labhil.signals import Direction, Hold, Signal

_OF_THE_KIND = {signal.name: signal for signal in UR5.signals()}


@dataclass(frozen=True, slots=True)
class Reported:
    """One signal and the variable that it comes from; ``mask`` selects the bits of a word that are ours.

    A controller that does not know an ``optional`` one is used all the same; it is NaN then.
    """

    signal: Signal
    variable: str
    optional: bool = False
    mask: int = 0


def _as_is(name: str, optional: bool = False) -> Reported:
    return Reported(_OF_THE_KIND[name], name, optional)


def _status(name: str, unit: str, description: str, variable: str = "", mask: int = 0) -> Reported:
    signal = Signal(name, unit, Direction.STATUS, hold=Hold.ZERO, description=description)
    return Reported(signal, variable or name, optional=name not in NEEDED, mask=mask)


COMMAND_TIMEOUT = 0.3
"""How long the arm moves on without a word from the driver, s."""
DIGITAL_OUTPUTS = 8
TIMESTAMP = "timestamp"
"""The variable that holds the controller's clock, s."""
NEEDED = ("safety_mode", "runtime_state")
"""Status without which nobody could say whether the arm may be moved."""

REPORTED: tuple[Reported, ...] = (
    *(_as_is(name) for name in ("actual_q", "actual_qd", "actual_current")),
    *(_as_is(name) for name in ("target_q", "target_qd", "target_qdd", "target_current", "target_moment")),
    _as_is("joint_temperatures", optional=True),
    _as_is("actual_main_voltage", optional=True),
    _status("actual_robot_voltage", "V", "of the arm's supply"),
    _status("actual_robot_current", "A", "that the arm draws"),
    _status("robot_mode", "", "7 running; see the RTDE guide"),
    _status("safety_mode", "", "1 normal, 2 reduced, 3 protective stop, 6 and 7 emergency stop, 9 fault"),
    _status("robot_status_bits", "", "bit 0 power on, bit 1 program running"),
    _status("safety_status_bits", "", "bit 0 normal, bit 2 protective stop, bit 7 emergency stop"),
    _status("runtime_state", "", "1 stopped, 2 playing, 4 paused"),
    _status("speed_scaling", "", "share of the programmed speed that is in effect"),
    _status("target_speed_fraction", "", "where the speed slider stands, 0 to 1"),
    _status(
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
"""What the client process is doing: ours, not the controller's."""

TARGET = _OF_THE_KIND["target_q"]
SPEED = next(item.signal for item in REPORTED if item.signal.name == "target_speed_fraction")
OUTPUTS = next(item.signal for item in REPORTED if item.signal.name == "standard_digital_outputs")

TARGET_COLUMNS = TARGET.columns()
assert len(TARGET_COLUMNS) == JOINTS
