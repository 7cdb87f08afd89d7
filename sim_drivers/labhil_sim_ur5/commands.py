"""What each command of the client does: one function a command, by its number."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from labhil_sim_ur5.motion import (
    Halt,
    JointMove,
    JointSpeed,
    LineMove,
    Motion,
    Servo,
    ToolSpeed,
)
from labhil_sim_ur5.poses import NO_OFFSET, Pose, pose_times

if TYPE_CHECKING:
    from labhil_sim_ur5.program import Program

Handler = Callable[["Program"], Motion | None]

REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Carried out at every tick."""


def move_joints(program: Program) -> Motion | None:
    """``moveJ``: command 1."""
    return _joint_move(program, program.registers.six(0))


def move_joints_to_pose(program: Program) -> Motion | None:
    """``moveJ_IK``: command 2."""
    return _joint_move(program, solved(program, program.registers.six(0)))


def _joint_move(program: Program, q: Pose) -> Motion | None:
    registers, controller = program.registers, program.controller
    motion = JointMove(controller.plan.q, np.array(q), registers.number(6), registers.number(7))
    return program.start(motion, registers.integer(1) == 1)


def move_line(program: Program) -> Motion | None:
    """``moveL``: command 3."""
    return _line_move(program, program.registers.six(0))


def move_line_to_joints(program: Program) -> Motion | None:
    """``moveL_FK``: command 4."""
    controller = program.controller
    return _line_move(program, controller.geometry.pose(program.registers.six(0), controller.tool))


def _line_move(program: Program, pose: Pose) -> Motion | None:
    registers, controller = program.registers, program.controller
    speed, acceleration = registers.number(6), registers.number(7)
    motion = LineMove(controller.geometry, controller.tool, controller.plan.q, pose, speed, acceleration)
    return program.start(motion, registers.integer(1) == 1)


def solved(program: Program, pose: Pose, near: Pose | None = None) -> Pose:
    """Return the joint angles for a pose; ScriptError when there are none, which ends a program."""
    from labhil_sim_ur5.program import ScriptError

    controller = program.controller
    q = controller.geometry.inverse(pose, controller.plan.q if near is None else near, controller.tool)
    if q is None:
        raise ScriptError("get_inverse_kin: unable to find an inverse kinematics solution")
    return q


def servo_joints(program: Program) -> Motion | None:
    """``servoJ``: command 11."""
    return _servo(program, program.registers.six(0))


def servo_pose(program: Program) -> Motion | None:
    """``servoL``: command 24."""
    return _servo(program, solved(program, program.registers.six(0)))


def _servo(program: Program, q: Pose) -> None:
    motion = program.continuous
    if not isinstance(motion, Servo) or not program.controller.moving(motion):
        program.stop_asynchronous()
        program.refuse_second()
        motion = Servo(program.controller.plan)
        program.continuous = program.controller.begin(motion)
    motion.aim(q, program.registers.number(9), program.registers.number(10))


def speed_joints(program: Program) -> Motion | None:
    """``speedJ``: command 9."""
    motion = program.continuous
    if not isinstance(motion, JointSpeed) or not program.controller.moving(motion):
        program.stop_asynchronous()
        program.refuse_second()
        motion = JointSpeed(program.controller.plan)
        program.continuous = program.controller.begin(motion)
    motion.aim(program.registers.six(0), program.registers.number(6))
    return None


def speed_tool(program: Program) -> Motion | None:
    """``speedL``: command 10."""
    tool_speed(program, program.registers.six(0), program.registers.number(6))
    return None


def tool_speed(program: Program, twist: Pose, acceleration: float) -> None:
    """Let the tool go to a velocity in the base's frame."""
    motion, controller = program.continuous, program.controller
    if not isinstance(motion, ToolSpeed) or not controller.moving(motion):
        program.stop_asynchronous()
        program.refuse_second()
        motion = ToolSpeed(controller.plan, controller.geometry, controller.tool)
        program.continuous = controller.begin(motion)
    motion.aim(twist, acceleration)


def stop_speed(program: Program) -> Motion | None:
    """``speedStop``: command 15; along a line after ``speedL``, joint by joint after ``speedJ``."""
    deceleration = program.registers.number(0)
    if isinstance(program.continuous, ToolSpeed):
        return halt_tool(program, deceleration)
    return halt_joints(program, deceleration)


def stop_servo(program: Program) -> Motion | None:
    """``servoStop``: command 16."""
    return halt_tool(program, program.registers.number(0))


def stop_line(program: Program) -> Motion | None:
    """``stopL``: command 33."""
    return _stopped(program, halt_tool(program, program.registers.number(0)))


def stop_joints(program: Program) -> Motion | None:
    """``stopJ``: command 34."""
    return _stopped(program, halt_joints(program, program.registers.number(0)))


def _stopped(program: Program, motion: Motion) -> Motion | None:
    if program.registers.integer(1) != 1:
        return motion
    program.asynchronous = motion
    program.progress.started()
    return None


def halt_tool(program: Program, deceleration: float) -> Motion:
    """Bring the tool to rest along its way."""
    controller = program.controller
    halt = Halt.of_tool(controller.plan, deceleration, controller.geometry, controller.tool)
    return _halt(program, halt)


def halt_joints(program: Program, deceleration: float) -> Motion:
    """Bring the joints to rest along their way."""
    return _halt(program, Halt.of_joints(program.controller.plan, deceleration))


def _halt(program: Program, halt: Halt) -> Motion:
    program.stop_asynchronous()
    program.continuous = None
    return program.controller.begin(halt)


COMMANDS: Mapping[int, Handler] = {
    1: move_joints,
    2: move_joints_to_pose,
    3: move_line,
    4: move_line_to_joints,
    9: speed_joints,
    10: speed_tool,
    11: servo_joints,
    15: stop_speed,
    16: stop_servo,
    24: servo_pose,
    33: stop_line,
    34: stop_joints,
}
"""Every command that the twin knows."""
