"""Driver plugin for the DC motor bench on a serial line."""

from labhil_dc_motor.driver import DcMotorDriver

__all__ = ["DcMotorDriver"]
