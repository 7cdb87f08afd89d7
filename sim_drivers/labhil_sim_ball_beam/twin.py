"""The twin of the ball and beam."""

from __future__ import annotations

from collections.abc import Mapping

from labhil.plants.ball_beam_definition import BALL_BEAM
from labhil.serial_twin.bench import SimulatedRig
from labhil.serial_twin.settings import TwinSettings, check_range, settable_world
from labhil.serial_twin.twin import SerialTwin


def check(device: Mapping[str, float]) -> None:
    """Check the settings of the servo; UsageError for a value out of range."""
    check_range(device, "pulse_resolution", 1e-7, 1e-4)


def make(settings: TwinSettings) -> SimulatedRig:
    """Make the simulated rig; its module is imported here, since compiling the plant takes time."""
    from labhil_sim_ball_beam.rig import BallBeamBench

    return BallBeamBench(settings)


DEVICE: Mapping[str, float] = {
    "pulse_resolution": 1e-6,  # s, step of the servo's pulse width; 180° are 1 ms
}
TERMS = ("viscous_friction", "coulomb_friction", "stribeck_friction")

TWIN = SerialTwin(
    name="ball_beam",
    rig="ball_beam",
    description="simulated ball and beam: servo pulse in, potentiometer counts out, 100 Hz",
    effects={name: effect.about for name, effect in BALL_BEAM.effects.items()},
    settable=settable_world(BALL_BEAM, TERMS, DEVICE, check),
    make=make,
)
