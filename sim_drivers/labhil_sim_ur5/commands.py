"""Every command of the client by its number."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from labhil_sim_ur5 import moves, queries
from labhil_sim_ur5.motion import Motion

if TYPE_CHECKING:
    from labhil_sim_ur5.program import Program

REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Carried out at every tick."""

COMMANDS: Mapping[int, Callable[[Program], Motion | None]] = {
    1: moves.move_joints,
    2: moves.move_joints_to_pose,
    3: moves.move_line,
    4: moves.move_line_to_joints,
    6: queries.accept_quietly,
    7: moves.end_force_mode,
    8: queries.zero_force,
    9: moves.speed_joints,
    10: moves.speed_tool,
    11: moves.servo_joints,
    12: moves.servo_circular,
    15: moves.stop_speed,
    16: moves.stop_servo,
    17: queries.set_payload,
    18: queries.accept,
    19: queries.accept,
    20: queries.accept,
    21: queries.accept,
    24: moves.servo_pose,
    25: queries.contact,
    26: queries.step_time,
    27: queries.history,
    28: queries.waypoint,
    29: queries.set_tool,
    30: queries.inverse_near,
    31: queries.protective_stop,
    33: moves.stop_line,
    34: moves.stop_joints,
    35: queries.set_watchdog,
    36: queries.pose_is_safe,
    37: queries.joints_are_safe,
    38: queries.joint_torques,
    39: queries.transform_pose,
    40: queries.tool_offset,
    41: moves.start_jog,
    42: moves.stop_jog,
    43: queries.forward_here,
    44: queries.forward_of,
    45: moves.move_path,
    46: queries.inverse_here,
    47: queries.steady,
    51: moves.move_until_contact,
    52: queries.accept,
    53: queries.accept,
    54: queries.freedrive_status,
    56: queries.accept,
    57: queries.accept,
    58: queries.flange_pose,
    59: queries.set_gravity,
    60: queries.has_inverse_here,
    61: queries.has_inverse_near,
    62: queries.start_contact,
    63: queries.stop_contact,
    64: queries.read_contact,
    65: queries.set_target_payload,
    66: queries.accept_quietly,
    67: queries.masses,
    68: queries.coriolis,
    69: queries.planned_accelerations,
    70: queries.jacobian,
    71: queries.jacobian_rate,
}
"""A handler returns the motion that the program waits for, if it does."""
