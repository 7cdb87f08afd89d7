"""The DC motor bench on its serial line."""

from __future__ import annotations

from labhil.driver import DriverSpec
from labhil.kinds import DC_MOTOR
from labhil.serial_rig.driver import SerialDriver
from labhil.serial_rig.rig import SerialRig
from labhil.signals import Stream

VOLTAGE = DC_MOTOR.inputs[0]
SPEED, CURRENT = DC_MOTOR.outputs
ANGLE, TEMPERATURE = DC_MOTOR.auxiliary
MAX_VOLTAGE = 12.0
"""Largest voltage of the amplifier in both directions, V."""

RIG = SerialRig(
    spec=DriverSpec(
        name="dc_motor",
        rig="dc_motor",
        description="DC motor on a serial line: voltage in, speed and current out, 100 Hz to 1 kHz",
        stream=Stream("state", (SPEED, CURRENT, ANGLE, TEMPERATURE, VOLTAGE), 100.0),
        commands=(VOLTAGE,),
        safe={VOLTAGE.name: 0.0},
        command_timeout=0.3,
        address_help="/dev/ttyACM0, /dev/ttyACM0@1000000 (baud), socket://host:port, rfc2217://host:port",
        ranges={VOLTAGE.name: (-MAX_VOLTAGE, MAX_VOLTAGE)},
        longest_output=3600.0,
    ),
    baud_rate=500_000,
    optional=frozenset({ANGLE.name, TEMPERATURE.name}),
    counters=frozenset({ANGLE.name}),
)


class DcMotorDriver(SerialDriver):
    """Commands a voltage; measures speed, current and optional angle and winding temperature; safe is 0 V."""

    rig = RIG
    spec = RIG.spec
