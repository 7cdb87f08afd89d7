"""Driver plugin for the solenoid bench on a serial line."""

from labhil_solenoid.driver import SolenoidDriver

__all__ = ["SolenoidDriver"]
