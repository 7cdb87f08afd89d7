"""The solenoid bench on its serial line; its current loop is in the device."""

from __future__ import annotations

from labhil.driver import DriverSpec
from labhil.kinds import SOLENOID
from labhil.serial_rig.driver import SerialDriver
from labhil.serial_rig.rig import SerialRig
from labhil.signals import Stream

CURRENT = SOLENOID.inputs[0]
POSITION = SOLENOID.outputs[0]
COMMAND, VOLTAGE, FORCE = SOLENOID.auxiliary
MAX_CURRENT = 2.7
"""Rated current of the coil, A."""
MAX_OUTPUT_TIME = 120.0
"""Longest time of a current without a break, s: at 2.7 A the coil overheats in a few minutes."""

RIG = SerialRig(
    spec=DriverSpec(
        name="solenoid",
        rig="solenoid",
        description="solenoid on a serial line: coil current commanded, plunger position out, 1 to 10 kHz",
        stream=Stream("state", (CURRENT, POSITION, VOLTAGE, FORCE, COMMAND), 1000.0),
        commands=(COMMAND,),
        safe={COMMAND.name: 0.0},
        command_timeout=0.3,
        address_help="/dev/ttyACM0, /dev/ttyACM0@2000000 (baud), socket://host:port, rfc2217://host:port",
        ranges={COMMAND.name: (0.0, MAX_CURRENT)},
        longest_output=MAX_OUTPUT_TIME,
    ),
    baud_rate=500_000,
    optional=frozenset({FORCE.name}),
)


class SolenoidDriver(SerialDriver):
    """Commands a current; measures current, position, voltage and, with a load cell, force; safe is 0 A."""

    rig = RIG
    spec = RIG.spec
