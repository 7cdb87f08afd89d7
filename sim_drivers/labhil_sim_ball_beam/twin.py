"""The twin of the ball and beam."""

from __future__ import annotations

from collections.abc import Mapping

from labhil.plants.effects import EFFECTS, all_parameters, resolve
from labhil.serial_twin.bench import SimulatedRig
from labhil.serial_twin.settings import Settable, TwinSettings, check_range
from labhil.serial_twin.twin import SerialTwin


def check(device: Mapping[str, float]) -> None:
    """Check the settings of the servo; UsageError for a value out of range."""
    check_range(device, "pulse_resolution", 1e-7, 1e-4)


def make(settings: TwinSettings) -> SimulatedRig:
    """Make the simulated rig; its module is imported here, since compiling the plant takes time."""
    from labhil_sim_ball_beam.rig import BallBeamBench

    return BallBeamBench(settings)


SETTABLE = Settable(
    default_terms=("viscous_friction", "coulomb_friction", "stribeck_friction"),
    plant=all_parameters(),
    resolve=resolve,
    device={"pulse_resolution": 1e-6},  # s, step of the servo's pulse width; 180° are 1 ms
    check=check,
)

TWIN = SerialTwin(
    name="ball_beam",
    rig="ball_beam",
    description="simulated ball and beam: servo pulse in, potentiometer counts out, 100 Hz",
    effects={name: effect.about for name, effect in EFFECTS.items()},
    settable=SETTABLE,
    make=make,
)
