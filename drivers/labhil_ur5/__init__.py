"""Driver plugin for Universal Robots' arms on their real-time data exchange (RTDE)."""

from labhil_ur5.driver import Ur5Cb3Driver, Ur5Driver

__all__ = ["Ur5Cb3Driver", "Ur5Driver"]
