"""A simulated ball and beam on the real wire: a pty or a TCP port that speaks the framed serial protocol."""

from labhil_sim_ball_beam.twin import TWIN

__all__ = ["TWIN"]
