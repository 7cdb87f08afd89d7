"""Commands of the client that move the arm: one function per command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labhil.signals import FloatArray
from labhil_sim_ur5.following import Approach, JointSpeed, Servo, ToolSpeed
from labhil_sim_ur5.motion import Halt, JointMove, LineMove, Motion, Plan
from labhil_sim_ur5.paths import Path, UntilContact
from labhil_sim_ur5.poses import NO_OFFSET, Pose, Rotation, rotate, rotation_of
from labhil_sim_ur5.script import ScriptError, Statement

if TYPE_CHECKING:
    from labhil_sim_ur5.program import Program
CONTACT_STOP = 3.0
"""Deceleration after a contact, m/s², as in the client's program."""


def move_joints(program: Program) -> Motion | None:
    """``moveJ``: command 1."""
    return _joint_move(program, program.registers.six(0))


def move_joints_to_pose(program: Program) -> Motion | None:
    """``moveJ_IK``: command 2."""
    return _joint_move(program, solve(program, program.registers.six(0)))


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


def solve(program: Program, pose: Pose, near: Pose | None = None) -> Pose:
    """Return the joint angles for a pose.

    Raises:
        ScriptError: There are none, which ends the program.
    """
    controller = program.controller
    q = controller.geometry.inverse(pose, controller.plan.q if near is None else near, controller.tool)
    if q is None:
        raise ScriptError("get_inverse_kin: unable to find an inverse kinematics solution")
    return q


def servo_joints(program: Program) -> None:
    """``servoJ``: command 11."""
    _servo(program, program.registers.six(0))


def servo_pose(program: Program) -> None:
    """``servoL``: command 24."""
    _servo(program, solve(program, program.registers.six(0)))


def servo_circular(program: Program) -> None:
    """``servoC``: command 12; the blend radius is ignored."""
    motion, controller, registers = program.continuous, program.controller, program.registers
    if not isinstance(motion, Approach) or not controller.is_moving(motion):
        program.stop_asynchronous()
        program.check_free()
        motion = Approach(controller.plan, controller.geometry, controller.tool)
        program.continuous = controller.start_motion(motion)
    motion.set_target(registers.six(0), registers.number(6), registers.number(7))


def _servo(program: Program, q: Pose) -> None:
    motion = program.continuous
    if not isinstance(motion, Servo) or not program.controller.is_moving(motion):
        program.stop_asynchronous()
        program.check_free()
        motion = Servo(program.controller.plan)
        program.continuous = program.controller.start_motion(motion)
    motion.set_target(q, program.registers.number(9), program.registers.number(10))


def speed_joints(program: Program) -> None:
    """``speedJ``: command 9."""
    motion = program.continuous
    if not isinstance(motion, JointSpeed) or not program.controller.is_moving(motion):
        program.stop_asynchronous()
        program.check_free()
        motion = JointSpeed(program.controller.plan)
        program.continuous = program.controller.start_motion(motion)
    motion.set_target(program.registers.six(0), program.registers.number(6))


def speed_tool(program: Program) -> None:
    """``speedL``: command 10."""
    set_tool_speed(program, program.registers.six(0), program.registers.number(6))


def set_tool_speed(program: Program, twist: Pose, acceleration: float) -> None:
    """Set the velocity of the tool in the base's frame, m/s and rad/s."""
    motion, controller = program.continuous, program.controller
    if not isinstance(motion, ToolSpeed) or not controller.is_moving(motion):
        program.stop_asynchronous()
        program.check_free()
        motion = ToolSpeed(controller.plan, controller.geometry, controller.tool)
        program.continuous = controller.start_motion(motion)
    motion.set_target(twist, acceleration)


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
    return _stop(program, halt_tool(program, program.registers.number(0)))


def stop_joints(program: Program) -> Motion | None:
    """``stopJ``: command 34."""
    return _stop(program, halt_joints(program, program.registers.number(0)))


def _stop(program: Program, motion: Motion) -> Motion | None:
    if program.registers.integer(1) != 1:
        return motion
    program.asynchronous = motion
    program.progress.start()
    return None


def halt_tool(program: Program, deceleration: float) -> Motion:
    """Bring the tool to rest on its path."""
    controller = program.controller
    halt = Halt.of_tool(controller.plan, deceleration, controller.geometry, controller.tool)
    return _halt(program, halt)


def halt_joints(program: Program, deceleration: float) -> Motion:
    """Bring the joints to rest on their path."""
    return _halt(program, Halt.of_joints(program.controller.plan, deceleration))


def _halt(program: Program, halt: Halt) -> Motion:
    program.stop_asynchronous()
    program.continuous = None
    return program.controller.start_motion(halt)


def start_jog(program: Program) -> None:
    """``jogStart``: command 41; speeds in the frame of the base (0), of the tool (1) or a given one (2)."""
    registers, controller = program.registers, program.controller
    speeds, feature = registers.six(0), round(registers.number(6))
    frame = NO_OFFSET
    if feature == 1:
        frame = controller.geometry.pose(controller.reading.q, controller.tool)
    elif feature == 2:
        frame = registers.six(8)
    rotation = rotation_of(*frame[3:])
    set_tool_speed(program, _turn_twist(rotation, speeds), registers.number(7))


def _turn_twist(rotation: Rotation, twist: Pose) -> Pose:
    return (*rotate(rotation, twist[:3]), *rotate(rotation, twist[3:]))


def stop_jog(program: Program) -> Motion | None:
    """``jogStop``: command 42."""
    return halt_tool(program, 1.2)


def move_until_contact(program: Program) -> Motion | None:
    """``moveUntilContact``: command 51, e-Series from 5.4; contacts are set by ``Faults``."""
    registers, controller = program.registers, program.controller
    if not controller.version.has((99, 4)):
        return None
    speed = ToolSpeed(controller.plan, controller.geometry, controller.tool)
    speed.set_target(registers.six(0), registers.number(12))
    tool = controller.tool

    def stop(plan: Plan) -> Halt:
        return Halt.of_tool(plan, CONTACT_STOP, controller.geometry, tool)

    return program.start(UntilContact(speed, stop, lambda: controller.contact > 0), False)


def end_force_mode(program: Program) -> Motion | None:
    """``forceModeStop``: command 7."""
    return halt_tool(program, 10.0)


def move_path(program: Program) -> Motion | None:
    """``moveJ(path)``, ``moveL(path)``, ``movePath``: command 45; the path is in the script."""
    controller = program.controller
    moves = []
    end = controller.plan.q
    for statement in program.script.path:
        if statement.name == "signal_async_progress":
            continue
        move = make_move(program, statement, end)
        if move is None:
            controller.log(f"line not understood in a path: {statement.line}")
            continue
        moves.append(move)
        end = move[1]
    if not moves:
        return None
    asynchronous = program.registers.integer(1) == 1
    on_move = program.progress.set_waypoint if asynchronous else program.progress.pass_waypoint
    return program.start(Path(controller.geometry, controller.plan.q, moves, on_move), asynchronous)


Move = tuple[Callable[[FloatArray], Motion], FloatArray, float]


def make_move(program: Program, statement: Statement, begin: FloatArray) -> Move | None:
    """Return the move of a script's line: a function that makes it at its start, its end, its blend radius.

    Returns None when the line is no ``movej``, ``movel`` or ``movep``.

    Raises:
        ScriptError: Its pose is out of reach.
    """
    six = statement.six()
    if statement.name not in {"movej", "movel", "movep"} or six is None:
        return None
    controller = program.controller
    is_joint_move = statement.name == "movej"
    speed = statement.number("v", 2, 1.05 if is_joint_move else 0.25)
    acceleration = statement.number("a", 1, 1.4 if is_joint_move else 1.2)
    target = as_six(six)
    is_pose = statement.poses[0]
    end = np.array(solve(program, target, as_six(begin.tolist())) if is_pose else target)
    radius = statement.number("r", 4, 0.0)
    if is_joint_move:
        return lambda q: JointMove(q, end, speed, acceleration), end, radius
    pose = target if is_pose else controller.geometry.pose(target, controller.tool)
    tool = controller.tool
    return lambda q: LineMove(controller.geometry, tool, q, pose, speed, acceleration), end, radius


def as_six(values: Sequence[float]) -> Pose:
    """Return six numbers as a pose or joint angles."""
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)
