"""Driver plugin for the ball-and-beam bench on a serial line."""

from labhil_ball_beam.driver import BallBeamDriver

__all__ = ["BallBeamDriver"]
