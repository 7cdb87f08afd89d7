"""A simulated solenoid on the real wire: a pty or a TCP port that speaks the framed serial protocol."""

from labhil_sim_solenoid.twin import TWIN

__all__ = ["TWIN"]
