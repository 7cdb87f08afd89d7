"""The twin of the DC motor."""

from __future__ import annotations

from collections.abc import Mapping

from labhil.plants.dc_motor_definition import MOTOR
from labhil.serial_twin.bench import SimulatedRig
from labhil.serial_twin.settings import TwinSettings, check_range, check_whole, settable_world
from labhil.serial_twin.twin import SerialTwin


def check(device: Mapping[str, float]) -> None:
    """Check the settings of the electronics; UsageError for a value out of range."""
    check_range(device, "sample_rate", 20.0, 1000.0)
    check_whole(device, "samples_per_frame", 1, 23)
    check_whole(device, "adc_bits", 8, 16)
    check_whole(device, "encoder", 0, 1_000_000)
    check_whole(device, "temperature_sensor", 0, 1)
    check_range(device, "largest_speed", 1.0, 10_000.0)
    check_range(device, "largest_current", 0.1, 1000.0)
    check_range(device, "longest_output", 1.0, 65_535.0)


def make(settings: TwinSettings) -> SimulatedRig:
    """Make the simulated rig; its module is imported here, since compiling the plant takes time."""
    from labhil_sim_dc_motor.rig import DcMotorBench

    return DcMotorBench(settings)


DEVICE: Mapping[str, float] = {
    "sample_rate": 100.0,  # Hz
    "samples_per_frame": 1.0,
    "adc_bits": 12.0,
    "encoder": 2000.0,  # counts per turn; 0: not fitted
    "temperature_sensor": 0.0,  # 1: fitted
    "largest_speed": 40.0,  # rad/s, end of the tachometer's range
    "largest_current": 12.0,  # A, end of the current sensor's range
    "longest_output": 65_535.0,  # s, the device's own limit on a voltage without a break
}

TWIN = SerialTwin(
    name="dc_motor",
    rig="dc_motor",
    description="simulated DC motor: voltage in; speed, current and angle out, 100 Hz to 1 kHz",
    effects={name: effect.about for name, effect in MOTOR.effects.items()},
    settable=settable_world(MOTOR, ("viscous_friction", "coulomb_friction"), DEVICE, check),
    make=make,
    sensors={"angle": "encoder", "winding_temperature": "temperature_sensor"},
)
