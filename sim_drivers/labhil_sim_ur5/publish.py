"""Conversion of the controller's state to the variables that clients read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labhil_sim_ur5.modes import JOINT_MODE, POWER_ON, PROGRAM_RUNNING, SAFETY_BITS, RobotMode, Runtime
from labhil_sim_ur5.poses import Pose, rotate, rotation_of, transpose

if TYPE_CHECKING:
    from labhil.signals import FloatArray
    from labhil_sim_ur5.controller import Controller

FORCE_PERIOD = 0.016
"""Time between two estimates of the force at the tool, s."""
FORCE_CUT_OFF = 5.0
"""Cut-off frequency of the low pass of that force, Hz."""
MIN_DETERMINANT = 1e-3
"""Determinant of the Jacobian below which the estimate of the force is not updated."""
IDLE_CURRENT = 0.6
"""Current of the controller without its motors, A."""

TOOL_PREFIXES = (
    "actual_TCP_", "target_TCP_", "actual_tool_accelerometer", "tcp_force_", "ft_raw_", "elbow_",
)  # fmt: skip
"""Prefixes of variables of the tool."""


def publish(controller: Controller, tool: bool = True) -> None:
    """Write all variables for this tick; those of the tool only where ``tool`` is set."""
    values, plan, reading = controller.values, controller.plan, controller.reading
    values["timestamp"] = controller.ticks * controller.period
    values["target_q"], values["target_qd"], values["target_qdd"] = (
        _as_tuple(plan.q),
        _as_tuple(plan.qd),
        _as_tuple(plan.qdd),
    )
    values["target_current"], values["target_moment"] = (
        _as_tuple(reading.target_current),
        _as_tuple(reading.target_moment),
    )
    values["actual_q"], values["actual_qd"] = _as_tuple(reading.q), _as_tuple(reading.qd)
    values["actual_current"] = _as_tuple(reading.current)
    values["joint_control_output"] = values["target_current"]
    values["joint_temperatures"] = _as_tuple(reading.temperature)
    values["actual_main_voltage"] = values["actual_robot_voltage"] = reading.voltage
    values["actual_joint_voltage"] = (reading.voltage,) * 6
    values["actual_robot_current"] = IDLE_CURRENT + _motor_current(controller)
    if "actual_current_as_torque" in values:
        values["actual_current_as_torque"] = _as_tuple(reading.current * controller.arm.torque_constant)
    if tool:
        _publish_tool(controller)
    _publish_modes(controller)


def _motor_current(controller: Controller) -> float:
    """Supply current of the motors' power, A."""
    reading = controller.reading
    power = float((reading.current * controller.arm.torque_constant) @ reading.qd)
    return max(power, 0.0) / max(reading.voltage, 1.0)


def _publish_tool(controller: Controller) -> None:
    values, geometry, tool = controller.values, controller.geometry, controller.tool
    plan, reading = controller.plan, controller.reading
    pose = geometry.pose(reading.q, tool)
    values["actual_TCP_pose"], values["target_TCP_pose"] = pose, geometry.pose(plan.q, tool)
    jacobian = geometry.jacobian(reading.q, tool)
    values["actual_TCP_speed"] = _as_tuple(jacobian @ reading.qd)
    values["target_TCP_speed"] = _as_tuple(jacobian @ plan.qd)
    values["actual_tool_accelerometer"] = _acceleration(controller, pose, jacobian)
    ticks = controller.ticks - controller.force_at
    if ticks * controller.period >= FORCE_PERIOD:
        controller.force_at = controller.ticks
        force = _estimate_force(controller, jacobian, ticks * controller.period)
        values["actual_TCP_force"] = force
        values["tcp_force_scalar"] = float(np.linalg.norm(force[:3]))
        if "ft_raw_wrench" in values:
            values["ft_raw_wrench"] = force
    if "elbow_position" in values:
        position, velocity = geometry.elbow(reading.q, reading.qd)
        values["elbow_position"], values["elbow_velocity"] = position, velocity


def _acceleration(controller: Controller, pose: Pose, jacobian: FloatArray) -> tuple[float, float, float]:
    """Reading of an accelerometer in the tool's frame, m/s²: acceleration minus gravity."""
    ax, ay, az = (jacobian[:3] @ controller.plan.qdd).tolist()
    gx, gy, gz = controller.gravity
    return rotate(transpose(rotation_of(*pose[3:])), (ax - gx, ay - gy, az - gz))


def _estimate_force(controller: Controller, jacobian: FloatArray, h: float) -> Pose:
    """External force on the tool, N and N·m: the motors' torque minus model and friction, filtered."""
    previous = controller.values["actual_TCP_force"]
    assert isinstance(previous, tuple)
    if abs(np.linalg.det(jacobian)) < MIN_DETERMINANT:
        return _as_pose(previous)
    reading = controller.reading
    external = reading.current * controller.arm.torque_constant - reading.friction - reading.target_moment
    weight = 1.0 - np.exp(-2.0 * np.pi * FORCE_CUT_OFF * h)
    wrench = -np.linalg.solve(jacobian.T, external) - controller.force_zero
    previous_force = np.array(previous)
    return _as_tuple(previous_force + weight * (wrench - previous_force))


def _publish_modes(controller: Controller) -> None:
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
    values["speed_scaling"] = pace.factor
    values["target_speed_fraction"] = pace.slider


def _as_tuple(array: FloatArray) -> Pose:
    a, b, c, d, e, f = array.tolist()
    return (a, b, c, d, e, f)


def _as_pose(values: tuple[float, ...]) -> Pose:
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)
