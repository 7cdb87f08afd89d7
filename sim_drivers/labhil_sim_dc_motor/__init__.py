"""A simulated DC motor on the real wire: a pty or a TCP port that speaks the framed serial protocol."""

from labhil_sim_dc_motor.twin import TWIN

__all__ = ["TWIN"]
