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
LARGEST_CURRENT = 2.7
"""What the coil is made for, A."""
LONGEST_OUTPUT = 120.0
"""How long (s) the coil may carry current without a break: at 2.7 A it would overheat in a few minutes."""

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
        ranges={COMMAND.name: (0.0, LARGEST_CURRENT)},
        longest_output=LONGEST_OUTPUT,
    ),
    baud_rate=500_000,
    optional=frozenset({FORCE.name}),
)


class SolenoidDriver(SerialDriver):
    """Current command out; current, position, voltage and, with a load cell, force in; safe is 0 A."""

    rig = RIG
    spec = RIG.spec
