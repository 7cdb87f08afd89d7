"""Commands of the client that ask the controller something, or tell it something, without motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labhil_sim_ur5.kinematics import JOINT_LIMIT
from labhil_sim_ur5.motion import AT_REST
from labhil_sim_ur5.moves import as_six, solve
from labhil_sim_ur5.poses import Point, Pose, pose_times

if TYPE_CHECKING:
    from labhil.signals import FloatArray
    from labhil_sim_ur5.program import Program

STEADY_VELOCITY = 1e-2
"""rad/s of any joint, below which an arm without a plan is steady; its own noise is a tenth of that."""
DERIVATIVE_STEP = 1e-6
UPPER = 36
"""Where a matrix goes on in the float registers, after its first 24 elements."""
FREEDRIVE_FREE = 0


def zero_force(program: Program) -> None:
    """``zeroFtSensor``: command 8."""
    controller = program.controller
    controller.publish()
    controller.force_zero = controller.force_zero + np.array(controller.values["actual_TCP_force"])


def set_payload(program: Program) -> None:
    """``setPayload``: command 17; with an e-Series and no centre the old one stays."""
    _carry(program, (0.0,) * 6)


def set_target_payload(program: Program) -> None:
    """``setTargetPayload``: command 65, e-Series from 5.10."""
    if program.controller.version.has((99, 10)):
        _carry(program, program.registers.six(4))


def _carry(program: Program, inertia: tuple[float, ...]) -> None:
    registers, controller = program.registers, program.controller
    centre: Point = (registers.number(1), registers.number(2), registers.number(3))
    if centre == (0.0, 0.0, 0.0) and controller.version.major >= 5:
        centre = controller.payload[1]
    controller.carry(max(registers.number(0), 0.0), centre, inertia)


def set_tool(program: Program) -> None:
    """``setTcp``: command 29."""
    program.controller.tool = program.registers.six(0)


def tool_offset(program: Program) -> None:
    """``getTCPOffset``: command 40."""
    program.registers.answer(program.controller.tool)


def set_gravity(program: Program) -> None:
    """``setGravity``: command 59; m/s² towards the ceiling, as URScript has it."""
    x, y, z = (program.registers.number(i) for i in range(3))
    controller = program.controller
    controller.gravity = (-x, -y, -z)
    controller.carry(*controller.payload)


def contact(program: Program) -> None:
    """``toolContact``: command 25, e-Series from 5.4."""
    if program.controller.version.has((99, 4)):
        program.registers.answer_integer(1, program.controller.contact)


def step_time(program: Program) -> None:
    """``getStepTime``: command 26, e-Series from 5.4."""
    if program.controller.version.has((99, 4)):
        program.registers.answer([program.controller.period])


def history(program: Program) -> None:
    """``getActualJointPositionsHistory``: command 27, e-Series from 5.4."""
    controller = program.controller
    if controller.version.has((99, 4)) and controller.history:
        back = min(max(program.registers.integer(1), 0), len(controller.history) - 1)
        program.registers.answer(controller.history[-1 - back])


def waypoint(program: Program) -> None:
    """``getTargetWaypoint``: command 28, e-Series from 5.3; the pose that is planned now."""
    controller = program.controller
    if controller.version.has((99, 3)):
        program.registers.answer(controller.geometry.pose(controller.plan.q, controller.tool))


def inverse_near(program: Program) -> None:
    """``getInverseKinematics`` with ``qnear``: command 30."""
    registers = program.registers
    registers.answer(solve(program, registers.six(0), registers.six(6)))


def inverse_here(program: Program) -> None:
    """``getInverseKinematics``: command 46, near to where the arm is."""
    program.registers.answer(solve(program, program.registers.six(0)))


def has_inverse_near(program: Program) -> None:
    """``getInverseKinematicsHasSolution`` with ``qnear``: command 61, from 3.15 and 5.10."""
    _has_inverse(program, program.registers.six(6))


def has_inverse_here(program: Program) -> None:
    """``getInverseKinematicsHasSolution``: command 60."""
    _has_inverse(program, as_six(program.controller.plan.q.tolist()))


def _has_inverse(program: Program, near: Pose) -> None:
    controller = program.controller
    if controller.version.has((15, 10)):
        q = controller.geometry.inverse(program.registers.six(0), near, controller.tool)
        program.registers.answer_integer(1, int(q is not None))


def pose_is_safe(program: Program) -> None:
    """``isPoseWithinSafetyLimits``: command 36; safe is what the arm reaches."""
    controller = program.controller
    q = controller.geometry.inverse(program.registers.six(0), controller.plan.q, controller.tool)
    program.registers.answer_integer(1, int(q is not None))


def joints_are_safe(program: Program) -> None:
    """``isJointsWithinSafetyLimits``: command 37."""
    q = program.registers.six(0)
    program.registers.answer_integer(1, int(max(map(abs, q)) <= JOINT_LIMIT))


def protective_stop(program: Program) -> None:
    """``triggerProtectiveStop``: command 31."""
    program.controller.protective_stop("triggered by the program")


def set_watchdog(program: Program) -> None:
    """``setWatchdog``: command 35."""
    program.watch(program.registers.number(0))


def joint_torques(program: Program) -> None:
    """``getJointTorques``: command 38; without friction, which the controller takes off."""
    controller = program.controller
    reading = controller.reading
    program.registers.answer(reading.current * controller.arm.torque_constant - reading.friction)


def transform_pose(program: Program) -> None:
    """``poseTrans``: command 39."""
    registers = program.registers
    registers.answer(pose_times(registers.six(0), registers.six(6)))


def forward_here(program: Program) -> None:
    """``getForwardKinematics``: command 43."""
    controller = program.controller
    program.registers.answer(controller.geometry.pose(controller.reading.q, controller.tool))


def forward_of(program: Program) -> None:
    """``getForwardKinematics`` of given angles: command 44; the offset is what stands in its registers."""
    registers = program.registers
    registers.answer(program.controller.geometry.pose(registers.six(0), registers.six(6)))


def steady(program: Program) -> None:
    """``isSteady``: command 47."""
    controller = program.controller
    still = controller.motion is None or float(np.abs(controller.plan.qd).max()) < AT_REST
    slow = float(np.abs(controller.reading.qd).max()) < STEADY_VELOCITY
    program.registers.answer_integer(1, int(still and slow))


def freedrive_status(program: Program) -> None:
    """``getFreedriveStatus``: command 54, e-Series from 5.10."""
    if program.controller.version.has((99, 10)):
        program.registers.answer_integer(1, FREEDRIVE_FREE)


def flange_pose(program: Program) -> None:
    """``getActualToolFlangePose``: command 58."""
    controller = program.controller
    program.registers.answer(controller.geometry.pose(controller.reading.q))


def planned_accelerations(program: Program) -> None:
    """``getTargetJointAccelerations``: command 69, from 5.23."""
    if _has_dynamics(program):
        program.registers.answer(program.controller.plan.qdd)


def masses(program: Program) -> None:
    """``getMassMatrix``: command 67, from 5.23."""
    if _has_dynamics(program):
        controller = program.controller
        _answer_matrix(program, controller.arm.mass_matrix(controller.reading.q))


def coriolis(program: Program) -> None:
    """``getCoriolisAndCentrifugalTorques``: command 68, from 5.23."""
    if _has_dynamics(program):
        controller = program.controller
        program.registers.answer(controller.arm.coriolis(controller.reading.q, controller.reading.qd))


def jacobian(program: Program) -> None:
    """``getJacobian``: command 70, from 5.23."""
    if _has_dynamics(program):
        controller = program.controller
        _answer_matrix(program, controller.geometry.jacobian(controller.reading.q, controller.tool))


def jacobian_rate(program: Program) -> None:
    """``getJacobianTimeDerivative``: command 71, from 5.23."""
    if not _has_dynamics(program):
        return
    controller = program.controller
    q, step = controller.reading.q, DERIVATIVE_STEP * controller.reading.qd
    ahead = controller.geometry.jacobian(q + step, controller.tool)
    behind = controller.geometry.jacobian(q - step, controller.tool)
    _answer_matrix(program, (ahead - behind) / (2.0 * DERIVATIVE_STEP))


def _has_dynamics(program: Program) -> bool:
    return program.controller.version.has((99, 23))


def _answer_matrix(program: Program, matrix: FloatArray) -> None:
    """Column after column; the last twelve elements stand in the upper registers."""
    flat = matrix.T.ravel().tolist()
    program.registers.answer(flat[:24])
    program.registers.answer(flat[24:], UPPER)


def start_contact(program: Program) -> None:
    """``startContactDetection``: command 62, e-Series from 5.4."""
    program.watching_contact = True
    program.contact_steps = 0


def stop_contact(program: Program) -> None:
    """``stopContactDetection``: command 63."""
    program.watching_contact = False
    program.registers.answer_integer(1, program.contact_steps)


def read_contact(program: Program) -> None:
    """``readContactDetection``: command 64."""
    program.registers.answer_integer(1, program.contact_steps)


def accept(program: Program) -> None:
    """Answered as done: what it would do has no part in this world, such as force control."""
    program.controller.log(f"command {program.registers.command} is accepted, but has no effect on the twin")


def accept_quietly(program: Program) -> None:
    """The same for a command of every tick: logged once a program."""
    command = program.registers.command
    if command not in program.logged:
        program.logged.add(command)
        accept(program)
