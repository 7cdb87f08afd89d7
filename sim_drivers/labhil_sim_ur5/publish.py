"""From the controller's state to the variables that clients read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labhil_sim_ur5.modes import JOINT_MODE, POWER_ON, PROGRAM_RUNNING, SAFETY_BITS, RobotMode, Runtime
from labhil_sim_ur5.poses import Pose, rotate, rotation_of, transpose

if TYPE_CHECKING:
    from labhil.signals import FloatArray
    from labhil_sim_ur5.controller import Controller

FORCE_PERIOD = 0.016
"""s between two estimates of the force at the tool."""
FORCE_FILTER = 5.0
"""Hz of the low pass behind them."""
SINGULAR = 1e-3
"""Determinant of the Jacobian below which the estimate of the force is kept as it was."""
ELECTRONICS = 0.6
"""A that the controller draws beside its motors."""


TOOL = (
    "actual_TCP_", "target_TCP_", "actual_tool_accelerometer", "tcp_force_", "ft_raw_", "elbow_",
)  # fmt: skip
"""How the names of variables begin that are about the tool."""


def publish(controller: Controller, tool: bool = True) -> None:
    """Write all variables for this tick, those about the tool only when they are wanted."""
    values, plan, reading = controller.values, controller.plan, controller.reading
    values["timestamp"] = controller.ticks * controller.period
    values["target_q"], values["target_qd"], values["target_qdd"] = (
        _six(plan.q),
        _six(plan.qd),
        _six(plan.qdd),
    )
    values["target_current"], values["target_moment"] = (
        _six(reading.target_current),
        _six(reading.target_moment),
    )
    values["actual_q"], values["actual_qd"] = _six(reading.q), _six(reading.qd)
    values["actual_current"] = _six(reading.current)
    values["joint_control_output"] = values["target_current"]
    values["joint_temperatures"] = _six(reading.temperature)
    values["actual_main_voltage"] = values["actual_robot_voltage"] = reading.voltage
    values["actual_joint_voltage"] = (reading.voltage,) * 6
    values["actual_robot_current"] = ELECTRONICS + _motor_current(controller)
    if "actual_current_as_torque" in values:
        values["actual_current_as_torque"] = _six(reading.current * controller.arm.torque_constant)
    if tool:
        _tool(controller)
    _modes(controller)


def _motor_current(controller: Controller) -> float:
    """What the motors' work takes from the supply, A."""
    reading = controller.reading
    power = float((reading.current * controller.arm.torque_constant) @ reading.qd)
    return max(power, 0.0) / max(reading.voltage, 1.0)


def _tool(controller: Controller) -> None:
    values, geometry, tool = controller.values, controller.geometry, controller.tool
    plan, reading = controller.plan, controller.reading
    pose = geometry.pose(reading.q, tool)
    values["actual_TCP_pose"], values["target_TCP_pose"] = pose, geometry.pose(plan.q, tool)
    jacobian = geometry.jacobian(reading.q, tool)
    values["actual_TCP_speed"] = _six(jacobian @ reading.qd)
    values["target_TCP_speed"] = _six(jacobian @ plan.qd)
    values["actual_tool_accelerometer"] = _accelerometer(controller, pose, jacobian)
    since = controller.ticks - controller.force_at
    if since * controller.period >= FORCE_PERIOD:
        controller.force_at = controller.ticks
        force = _force(controller, jacobian, since * controller.period)
        values["actual_TCP_force"] = force
        values["tcp_force_scalar"] = float(np.linalg.norm(force[:3]))
        if "ft_raw_wrench" in values:
            values["ft_raw_wrench"] = force
    if "elbow_position" in values:
        place, velocity = geometry.elbow(reading.q, reading.qd)
        values["elbow_position"], values["elbow_velocity"] = place, velocity


def _accelerometer(controller: Controller, pose: Pose, jacobian: FloatArray) -> tuple[float, float, float]:
    """What an accelerometer at the tool feels in the tool's frame, m/s²: its acceleration less gravity."""
    ax, ay, az = (jacobian[:3] @ controller.plan.qdd).tolist()
    gx, gy, gz = controller.gravity
    return rotate(transpose(rotation_of(*pose[3:])), (ax - gx, ay - gy, az - gz))


def _force(controller: Controller, jacobian: FloatArray, h: float) -> Pose:
    """What acts on the tool from outside, N and N·m: what the motors give beyond model and friction."""
    before = controller.values["actual_TCP_force"]
    assert isinstance(before, tuple)
    if abs(np.linalg.det(jacobian)) < SINGULAR:
        return _as_pose(before)
    reading = controller.reading
    beyond = reading.current * controller.arm.torque_constant - reading.friction - reading.target_moment
    share = 1.0 - np.exp(-2.0 * np.pi * FORCE_FILTER * h)
    wrench = -np.linalg.solve(jacobian.T, beyond) - controller.force_zero
    old = np.array(before)
    return _six(old + share * (wrench - old))


def _modes(controller: Controller) -> None:
    values, pace = controller.values, controller.pace
    running = controller.runtime in {Runtime.PLAYING, Runtime.PAUSING, Runtime.RESUMING}
    powered = controller.robot_mode is not RobotMode.POWER_OFF
    values["robot_mode"] = int(controller.robot_mode)
    values["joint_mode"] = (JOINT_MODE[controller.robot_mode],) * 6
    values["safety_mode"] = int(controller.safety)
    if "safety_status" in values:
        values["safety_status"] = int(controller.safety)
    values["safety_status_bits"] = SAFETY_BITS[controller.safety]
    values["robot_status_bits"] = (POWER_ON if powered else 0) | (PROGRAM_RUNNING if running else 0)
    values["runtime_state"] = int(controller.runtime)
    values["speed_scaling"] = pace.now
    values["target_speed_fraction"] = pace.slider


def _six(array: FloatArray) -> Pose:
    a, b, c, d, e, f = array.tolist()
    return (a, b, c, d, e, f)


def _as_pose(values: tuple[float, ...]) -> Pose:
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)
