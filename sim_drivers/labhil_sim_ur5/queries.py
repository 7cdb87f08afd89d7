"""Commands of the client without motion: queries and settings of the controller."""

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
"""Joint speed below which an arm without a plan is steady, rad/s; its noise is a tenth of that."""
DERIVATIVE_STEP = 1e-6
UPPER_REGISTERS = 36
"""First float register of a matrix's elements after the 24th."""
FREEDRIVE_FREE = 0


def zero_force(program: Program) -> None:
    """``zeroFtSensor``: command 8."""
    controller = program.controller
    controller.publish()
    controller.force_zero = controller.force_zero + np.array(controller.values["actual_TCP_force"])


def set_payload(program: Program) -> None:
    """``setPayload``: command 17; without a centre, an e-Series keeps the old one."""
    _set_payload_inertia(program, (0.0,) * 6)


def set_target_payload(program: Program) -> None:
    """``setTargetPayload``: command 65, e-Series from 5.10."""
    if program.controller.version.has((99, 10)):
        _set_payload_inertia(program, program.registers.six(4))


def _set_payload_inertia(program: Program, inertia: tuple[float, ...]) -> None:
    registers, controller = program.registers, program.controller
    centre: Point = (registers.number(1), registers.number(2), registers.number(3))
    if centre == (0.0, 0.0, 0.0) and controller.version.major >= 5:
        centre = controller.payload[1]
    controller.set_payload(max(registers.number(0), 0.0), centre, inertia)


def set_tool(program: Program) -> None:
    """``setTcp``: command 29."""
    program.controller.tool = program.registers.six(0)


def answer_tool_offset(program: Program) -> None:
    """``getTCPOffset``: command 40."""
    program.registers.answer(program.controller.tool)


def set_gravity(program: Program) -> None:
    """``setGravity``: command 59; m/s² upwards, as in URScript."""
    x, y, z = (program.registers.number(i) for i in range(3))
    controller = program.controller
    controller.gravity = (-x, -y, -z)
    controller.set_payload(*controller.payload)


def answer_contact(program: Program) -> None:
    """``toolContact``: command 25, e-Series from 5.4."""
    if program.controller.version.has((99, 4)):
        program.registers.answer_integer(1, program.controller.contact)


def answer_step_time(program: Program) -> None:
    """``getStepTime``: command 26, e-Series from 5.4."""
    if program.controller.version.has((99, 4)):
        program.registers.answer([program.controller.period])


def answer_history(program: Program) -> None:
    """``getActualJointPositionsHistory``: command 27, e-Series from 5.4."""
    controller = program.controller
    if controller.version.has((99, 4)) and controller.history:
        steps_back = min(max(program.registers.integer(1), 0), len(controller.history) - 1)
        program.registers.answer(controller.history[-1 - steps_back])


def answer_waypoint(program: Program) -> None:
    """``getTargetWaypoint``: command 28, e-Series from 5.3; the planned pose."""
    controller = program.controller
    if controller.version.has((99, 3)):
        program.registers.answer(controller.geometry.pose(controller.plan.q, controller.tool))


def solve_inverse_near(program: Program) -> None:
    """``getInverseKinematics`` with ``qnear``: command 30."""
    registers = program.registers
    registers.answer(solve(program, registers.six(0), registers.six(6)))


def solve_inverse(program: Program) -> None:
    """``getInverseKinematics``: command 46, nearest to the planned position."""
    program.registers.answer(solve(program, program.registers.six(0)))


def check_inverse_near(program: Program) -> None:
    """``getInverseKinematicsHasSolution`` with ``qnear``: command 61, from 3.15 and 5.10."""
    _answer_has_inverse(program, program.registers.six(6))


def check_inverse(program: Program) -> None:
    """``getInverseKinematicsHasSolution``: command 60."""
    _answer_has_inverse(program, as_six(program.controller.plan.q.tolist()))


def _answer_has_inverse(program: Program, near: Pose) -> None:
    controller = program.controller
    if controller.version.has((15, 10)):
        q = controller.geometry.inverse(program.registers.six(0), near, controller.tool)
        program.registers.answer_integer(1, int(q is not None))


def check_pose(program: Program) -> None:
    """``isPoseWithinSafetyLimits``: command 36; every pose within reach is safe."""
    controller = program.controller
    q = controller.geometry.inverse(program.registers.six(0), controller.plan.q, controller.tool)
    program.registers.answer_integer(1, int(q is not None))


def check_joints(program: Program) -> None:
    """``isJointsWithinSafetyLimits``: command 37."""
    q = program.registers.six(0)
    program.registers.answer_integer(1, int(max(map(abs, q)) <= JOINT_LIMIT))


def trigger_protective_stop(program: Program) -> None:
    """``triggerProtectiveStop``: command 31."""
    program.controller.protective_stop("triggered by the program")


def set_watchdog(program: Program) -> None:
    """``setWatchdog``: command 35."""
    program.set_watchdog(program.registers.number(0))


def answer_joint_torques(program: Program) -> None:
    """``getJointTorques``: command 38; without friction, which the controller subtracts."""
    controller = program.controller
    reading = controller.reading
    program.registers.answer(reading.current * controller.arm.torque_constant - reading.friction)


def transform_pose(program: Program) -> None:
    """``poseTrans``: command 39."""
    registers = program.registers
    registers.answer(pose_times(registers.six(0), registers.six(6)))


def answer_forward(program: Program) -> None:
    """``getForwardKinematics``: command 43."""
    controller = program.controller
    program.registers.answer(controller.geometry.pose(controller.reading.q, controller.tool))


def answer_forward_of(program: Program) -> None:
    """``getForwardKinematics`` of given angles: command 44; the tool offset is in its registers."""
    registers = program.registers
    registers.answer(program.controller.geometry.pose(registers.six(0), registers.six(6)))


def answer_steady(program: Program) -> None:
    """``isSteady``: command 47."""
    controller = program.controller
    at_rest = controller.motion is None or float(np.abs(controller.plan.qd).max()) < AT_REST
    is_slow = float(np.abs(controller.reading.qd).max()) < STEADY_VELOCITY
    program.registers.answer_integer(1, int(at_rest and is_slow))


def answer_freedrive_status(program: Program) -> None:
    """``getFreedriveStatus``: command 54, e-Series from 5.10."""
    if program.controller.version.has((99, 10)):
        program.registers.answer_integer(1, FREEDRIVE_FREE)


def answer_flange_pose(program: Program) -> None:
    """``getActualToolFlangePose``: command 58."""
    controller = program.controller
    program.registers.answer(controller.geometry.pose(controller.reading.q))


def answer_planned_accelerations(program: Program) -> None:
    """``getTargetJointAccelerations``: command 69, from 5.23."""
    if _has_dynamics_commands(program):
        program.registers.answer(program.controller.plan.qdd)


def answer_mass_matrix(program: Program) -> None:
    """``getMassMatrix``: command 67, from 5.23."""
    if _has_dynamics_commands(program):
        controller = program.controller
        _answer_matrix(program, controller.arm.mass_matrix(controller.reading.q))


def answer_coriolis(program: Program) -> None:
    """``getCoriolisAndCentrifugalTorques``: command 68, from 5.23."""
    if _has_dynamics_commands(program):
        controller = program.controller
        program.registers.answer(controller.arm.coriolis(controller.reading.q, controller.reading.qd))


def answer_jacobian(program: Program) -> None:
    """``getJacobian``: command 70, from 5.23."""
    if _has_dynamics_commands(program):
        controller = program.controller
        _answer_matrix(program, controller.geometry.jacobian(controller.reading.q, controller.tool))


def answer_jacobian_rate(program: Program) -> None:
    """``getJacobianTimeDerivative``: command 71, from 5.23."""
    if not _has_dynamics_commands(program):
        return
    controller = program.controller
    q, step = controller.reading.q, DERIVATIVE_STEP * controller.reading.qd
    jacobian_ahead = controller.geometry.jacobian(q + step, controller.tool)
    jacobian_behind = controller.geometry.jacobian(q - step, controller.tool)
    _answer_matrix(program, (jacobian_ahead - jacobian_behind) / (2.0 * DERIVATIVE_STEP))


def _has_dynamics_commands(program: Program) -> bool:
    return program.controller.version.has((99, 23))


def _answer_matrix(program: Program, matrix: FloatArray) -> None:
    """Answer a matrix by columns; the last twelve elements are in the upper registers."""
    flat = matrix.T.ravel().tolist()
    program.registers.answer(flat[:24])
    program.registers.answer(flat[24:], UPPER_REGISTERS)


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
    """Accept a command without an effect on the twin, such as force control."""
    program.controller.log(f"command {program.registers.command} is accepted, but has no effect on the twin")


def accept_quietly(program: Program) -> None:
    """Accept a real-time command without an effect; it is logged once per program."""
    command = program.registers.command
    if command not in program.logged:
        program.logged.add(command)
        accept(program)
