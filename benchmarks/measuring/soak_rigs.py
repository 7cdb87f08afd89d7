"""The rigs of the soak (``measure_soak.py``): what their files state, and how they are moved."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Rig:
    """A rig of the lab: what its file states, and the sines that move it."""

    kind: str
    known: str
    limits: str
    signal: str
    tones: tuple[float, ...]
    """Hz"""
    amplitude: float
    offset: float = 0.0
    rests: bool = False
    """Whether it rests for the last ten seconds of each minute: a coil may not be on for long."""

    @property
    def file(self) -> str:
        """The text of its rig file."""
        return f'[rig]\nkind = "{self.kind}"\n[known]\n{self.known}\n[limits]\n{self.limits}\n'

    def setpoint(self, t: float) -> float:
        """What its actuator is to do at a time in s."""
        if self.rests and t % 60.0 > 50.0:
            return 0.0
        return self.offset + sum(self.amplitude * math.sin(2 * math.pi * tone * t) for tone in self.tones)


RIGS = (
    Rig(
        "ball_beam",
        "ball_mass = 0.261\nball_radius = 0.02\ncrank_radius = 0.08\nbeam_length = 0.40",
        "servo_angle = { min = -1.2, max = 1.2, rate = 12.0 }",
        "servo_angle", (0.31, 0.47, 0.83), 0.25,
    ),
    Rig(
        "dc_motor",
        "inertia = 0.1",
        "voltage = { min = -12.0, max = 12.0, rate = 5000.0 }\ncurrent = { min = -8.0, max = 8.0 }",
        "voltage", (0.11, 0.23, 0.57, 1.3), 2.0,
    ),
    Rig(
        "solenoid",
        "moving_mass = 0.064\nstop_low = 0.0\nstop_high = 0.005",
        "coil_current_command = { min = 0.0, max = 2.7, rate = 2000.0 }\n"
        "coil_current = { min = -0.2, max = 2.9 }",
        "coil_current_command", (0.7, 1.9, 3.1), 0.2, 0.85, True,
    ),
)  # fmt: skip
