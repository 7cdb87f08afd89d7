"""The twin of the solenoid."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from labhil.plants.solenoid_definition import SOLENOID
from labhil.serial_twin.bench import SimulatedRig
from labhil.serial_twin.settings import TwinSettings, check_range, check_whole, settable_world
from labhil.serial_twin.twin import SerialTwin
from labhil.signals import FloatArray


def check(device: Mapping[str, float]) -> None:
    """Check the settings of the electronics; UsageError for a value out of range."""
    check_range(device, "sample_rate", 100.0, 10_000.0)
    check_whole(device, "samples_per_frame", 1, 23)
    check_whole(device, "adc_bits", 8, 16)
    check_whole(device, "load_cell", 0, 1)
    check_range(device, "supply_voltage", 1.0, 100.0)
    check_range(device, "loop_rate", 1000.0, 100_000.0)
    check_range(device, "longest_output", 1.0, 65_535.0)


def make(settings: TwinSettings) -> SimulatedRig:
    """Make the simulated rig; its module is imported here, since compiling the plant takes time."""
    from labhil_sim_solenoid.rig import SolenoidBench

    return SolenoidBench(settings)


def force_map(path: Path) -> FloatArray:
    """Read a table of a magnet's measured forces."""
    from labhil.plants.force_map import force_map_of

    return force_map_of(path)


DEVICE: Mapping[str, float] = {
    "sample_rate": 1000.0,  # Hz
    "samples_per_frame": 5.0,
    "adc_bits": 12.0,
    "load_cell": 0.0,  # 1: fitted
    "supply_voltage": 24.0,  # V, either way
    "loop_rate": 10_000.0,  # Hz, of the current loop
    "longest_output": 600.0,  # s, the device's own limit on a current without a break
}

TWIN = SerialTwin(
    name="solenoid",
    rig="solenoid",
    description="simulated solenoid: coil current commanded, plunger position and coil out, 1 to 10 kHz",
    effects={name: effect.about for name, effect in SOLENOID.effects.items()},
    settable=settable_world(SOLENOID, ("viscous_friction", "coulomb_friction"), DEVICE, check),
    make=make,
    tables={"force_map": force_map},
    sensors={"magnetic_force": "load_cell"},
)
