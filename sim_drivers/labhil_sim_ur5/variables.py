"""Variables of a controller with their types, by the version of its software."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from labhil_sim_ur5.codec import WIDTHS, Value

REGISTERS = 48
"""Number of integer and of float registers in each direction; the upper half exists from 3.9 and 5.3."""
LOWER_REGISTERS = 24
NEVER = 99


@dataclass(frozen=True, slots=True, order=True)
class Version:
    """Version of the controller's software: 3 is CB3, 5 and 10 are e-Series and later."""

    major: int
    minor: int
    bugfix: int = 0
    build: int = 0

    @property
    def rate(self) -> float:
        """Rate of the controller, Hz."""
        return 125.0 if self.major == 3 else 500.0

    def has(self, since: tuple[int, int]) -> bool:
        """Return whether it is at least 3.``since[0]`` (CB3), or 5.``since[1]`` (all others)."""
        return self.minor >= since[0] if self.major == 3 else self.major > 5 or self.minor >= since[1]

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}"


VERSIONS: Mapping[str, Version] = {
    "3.15.8": Version(3, 15, 8, 106339),
    "5.4.0": Version(5, 4, 0),
    "5.9.0": Version(5, 9, 0),
    "5.11.1": Version(5, 11, 1, 108318),
    "5.23.0": Version(5, 23, 0),
    "5.26.0": Version(5, 26, 0),
    "10.11.0": Version(10, 11, 0),
}
"""Versions that version 1.6.5 of the client works with; 5.3.1 makes it crash."""
SERIES: Mapping[str, Version] = {"cb3": VERSIONS["3.15.8"], "e": VERSIONS["5.11.1"], **VERSIONS}
"""Values of ``--series``."""

_ALWAYS = (0, 0)

_DOUBLES = """timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum
actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1
standard_analog_output0 standard_analog_output1 io_current tool_analog_input0 tool_analog_input1
tool_output_current tool_temperature tcp_force_scalar"""
_VECTORS = """target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current
joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed
joint_temperatures actual_joint_voltage"""
_UINT32 = """runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode
tool_analog_input_types script_control_line output_bit_registers0_to_31 output_bit_registers32_to_63
input_bit_registers0_to_31 input_bit_registers32_to_63"""

_ADDED_LATER: Mapping[str, tuple[str, tuple[int, int]]] = {
    "elbow_position": ("VECTOR3D", (5, 0)),
    "elbow_velocity": ("VECTOR3D", (5, 0)),
    "safety_status": ("INT32", (10, 4)),
    "payload": ("DOUBLE", (11, 5)),
    "payload_cog": ("VECTOR3D", (11, 5)),
    "payload_inertia": ("VECTOR6D", (15, 11)),
    "tool_output_mode": ("UINT8", (NEVER, 0)),
    "tool_digital_output0_mode": ("UINT8", (NEVER, 0)),
    "tool_digital_output1_mode": ("UINT8", (NEVER, 0)),
    "ft_raw_wrench": ("VECTOR6D", (NEVER, 9)),
    "actual_current_as_torque": ("VECTOR6D", (NEVER, 23)),
}

_INPUTS: Mapping[str, str] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    "external_force_torque": "VECTOR6D",
}


def output_types(version: Version) -> dict[str, str]:
    """Return all variables that a controller of this version sends, with their types."""
    types = dict.fromkeys(_DOUBLES.split(), "DOUBLE")
    types |= dict.fromkeys(_VECTORS.split(), "VECTOR6D")
    types |= dict.fromkeys(_UINT32.split(), "UINT32")
    types |= {"actual_digital_input_bits": "UINT64", "actual_digital_output_bits": "UINT64"}
    types |= {"robot_mode": "INT32", "safety_mode": "INT32", "tool_output_voltage": "INT32"}
    types |= {"joint_mode": "VECTOR6INT32", "actual_tool_accelerometer": "VECTOR3D"}
    types |= {name: kind for name, (kind, since) in _ADDED_LATER.items() if version.has(since)}
    types |= dict(_registers("output", version))
    return types | dict(_registers("input", version))


def input_types(version: Version) -> dict[str, str]:
    """Return all variables that a client can set, with their types."""
    return dict(_INPUTS) | dict(_registers("input", version))


def _registers(direction: str, version: Version) -> Iterator[tuple[str, str]]:
    count = REGISTERS if version.has((9, 3)) else LOWER_REGISTERS
    for number in range(count):
        yield f"{direction}_int_register_{number}", "INT32"
        yield f"{direction}_double_register_{number}", "DOUBLE"
    for number in range(64, 128):
        yield f"{direction}_bit_register_{number}", "BOOL"


def zeros(types: Iterable[tuple[str, str]]) -> dict[str, Value]:
    """Return a zero value for each variable."""
    return {name: 0 if WIDTHS[kind] == 1 else (0.0,) * WIDTHS[kind] for name, kind in types}
