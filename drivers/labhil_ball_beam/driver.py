"""The ball-and-beam bench on its serial line."""

from __future__ import annotations

import math

from labhil.driver import DriverSpec
from labhil.kinds import BALL_BEAM
from labhil.serial_rig.driver import SerialDriver
from labhil.serial_rig.rig import SerialRig
from labhil.signals import Stream

POSITION = BALL_BEAM.outputs[0]
SERVO = BALL_BEAM.inputs[0]
MAX_ANGLE = math.pi / 2
"""Largest angle of the servo, rad."""

RIG = SerialRig(
    spec=DriverSpec(
        name="ball_beam",
        rig="ball_beam",
        description="ball and beam on a serial line: servo angle in, ball position out, 100 Hz",
        stream=Stream("state", (POSITION, SERVO), 100.0),
        commands=(SERVO,),
        safe={SERVO.name: 0.0},
        command_timeout=0.3,
        address_help="/dev/ttyACM0, socket://host:port, rfc2217://host:port",
        ranges={SERVO.name: (-MAX_ANGLE, MAX_ANGLE)},
    ),
    baud_rate=115200,
)


class BallBeamDriver(SerialDriver):
    """Commands the servo angle; measures the ball position at 100 Hz; safe is level."""

    rig = RIG
    spec = RIG.spec
