"""From the controller's state to the variables that clients read."""

from __future__ import annotations

from typing import TYPE_CHECKING


from labhil_sim_ur5.modes import (
    JOINT_MODE,
    POWER_ON,
    PROGRAM_RUNNING,
    SAFETY_BITS,
    RobotMode,
    Runtime,
)
from labhil_sim_ur5.poses import Pose

if TYPE_CHECKING:
    from labhil.signals import FloatArray
    from labhil_sim_ur5.controller import Controller

ROBOT_VOLTAGE = 48.0


def publish(controller: Controller) -> None:
    """Write all variables for this tick."""
    values, plan, reading = controller.values, controller.plan, controller.reading
    values["timestamp"] = controller.ticks * controller.period
    values["target_q"], values["target_qd"] = _six(plan.q), _six(plan.qd)
    values["target_qdd"] = _six(plan.qdd)
    values["target_current"] = _six(reading.target_current)
    values["target_moment"] = _six(reading.target_moment)
    q, qd = _six(reading.q), _six(reading.qd)
    values["actual_q"], values["actual_qd"] = q, qd
    values["actual_current"] = values["joint_control_output"] = _six(reading.current)
    values["joint_temperatures"] = _six(reading.temperature)
    values["actual_main_voltage"] = reading.voltage
    values["actual_robot_voltage"] = ROBOT_VOLTAGE
    _tool(controller)
    _modes(controller)


def _tool(controller: Controller) -> None:
    values, geometry, tool = controller.values, controller.geometry, controller.tool
    plan, reading = controller.plan, controller.reading
    values["actual_TCP_pose"] = geometry.pose(reading.q, tool)
    values["target_TCP_pose"] = geometry.pose(plan.q, tool)
    jacobian = geometry.jacobian(reading.q, tool)
    values["actual_TCP_speed"] = _six(jacobian @ reading.qd)
    values["target_TCP_speed"] = _six(jacobian @ plan.qd)


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
