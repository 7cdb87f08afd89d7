"""Every command of the client by its number."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from labhil_sim_ur5 import moves, queries
from labhil_sim_ur5.motion import Motion

if TYPE_CHECKING:
    from labhil_sim_ur5.program import Program

REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Commands that are executed in every tick."""

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
    25: queries.answer_contact,
    26: queries.answer_step_time,
    27: queries.answer_history,
    28: queries.answer_waypoint,
    29: queries.set_tool,
    30: queries.solve_inverse_near,
    31: queries.trigger_protective_stop,
    33: moves.stop_line,
    34: moves.stop_joints,
    35: queries.set_watchdog,
    36: queries.check_pose,
    37: queries.check_joints,
    38: queries.answer_joint_torques,
    39: queries.transform_pose,
    40: queries.answer_tool_offset,
    41: moves.start_jog,
    42: moves.stop_jog,
    43: queries.answer_forward,
    44: queries.answer_forward_of,
    45: moves.move_path,
    46: queries.solve_inverse,
    47: queries.answer_steady,
    51: moves.move_until_contact,
    52: queries.accept,
    53: queries.accept,
    54: queries.answer_freedrive_status,
    56: queries.accept,
    57: queries.accept,
    58: queries.answer_flange_pose,
    59: queries.set_gravity,
    60: queries.check_inverse,
    61: queries.check_inverse_near,
    62: queries.start_contact,
    63: queries.stop_contact,
    64: queries.read_contact,
    65: queries.set_target_payload,
    66: queries.accept_quietly,
    67: queries.answer_mass_matrix,
    68: queries.answer_coriolis,
    69: queries.answer_planned_accelerations,
    70: queries.answer_jacobian,
    71: queries.answer_jacobian_rate,
}
"""Handlers by command number; a handler may return a motion that the program waits for."""
