"""The controller: modes, program, motion and variables, tick by tick, in the server's thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

import numpy as np

from labhil.signals import FloatArray
from labhil_sim_ur5.arm import GRAVITY, PhysicalArm
from labhil_sim_ur5.codec import Value
from labhil_sim_ur5.kinematics import JOINT_LIMIT, Geometry
from labhil_sim_ur5.modes import RobotMode, Runtime, SafetyMode
from labhil_sim_ur5.motion import SPEED_LIMIT, Halt, Motion, MotionError, Plan
from labhil_sim_ur5.pace import Pace
from labhil_sim_ur5.poses import NO_OFFSET, Point, Pose
from labhil_sim_ur5.program import Program
from labhil_sim_ur5.publish import publish
from labhil_sim_ur5.script import Script
from labhil_sim_ur5.terminals import Terminals
from labhil_sim_ur5.variables import Version, output_types, zeros

START_DELAY = 0.05
"""Time from the upload of a program to its start, s."""
PROGRAM_STOP = 8.0
"""Deceleration of the arm when its program ends in motion, rad/s²."""
HISTORY_LENGTH = 1000
"""Number of ticks of joint angles kept (``get_actual_joint_positions_history``)."""

Log = Callable[[str], None]


class Controller:
    """An arm with its controller; :meth:`tick` simulates one period.

    Args:
        version: Version of its software.
        arm: The arm.
        geometry: Lengths of the arm.
        home: The plan at the start.
        log: Called with lines of the log.
    """

    def __init__(self, version: Version, arm: PhysicalArm, geometry: Geometry, home: Plan, log: Log) -> None:
        self.version = version
        self.period = 1.0 / version.rate
        self.geometry = geometry
        self.log = log
        self.values: dict[str, Value] = zeros(output_types(version).items())
        self.tool: Pose = NO_OFFSET
        self.payload: tuple[float, Point] = (0.0, (0.0, 0.0, 0.0))
        self.plan = home
        self.motion: Motion | None = None
        self.runtime = Runtime.STOPPED
        self.robot_mode = RobotMode.RUNNING
        self.safety = SafetyMode.NORMAL
        self.reason = ""
        self.program: Program | None = None
        self.last_script: Script | None = None
        self.program_name = "<unnamed>"
        self.pace = Pace()
        self.terminals = Terminals(self.values)
        self.history: deque[FloatArray] = deque(maxlen=HISTORY_LENGTH)
        self.ticks = 0
        self.updated: dict[str, int] = {}
        self.contact = 0
        """Answer of ``tool_contact``: ticks since a contact, 0 without one."""
        self.gravity: Point = GRAVITY
        self.force_zero = np.zeros(6)
        self.force_at = 0
        self.arm = arm
        self._pending: tuple[int, Script] | None = None
        self._stopped_at = 0
        arm.place(home.q)
        self.reading = arm.step(home, self.period)

    # Requests of clients ------------------------------------------------------------------------

    def receive(self, inputs: Mapping[str, Value]) -> None:
        """Set variables from a client."""
        for name, value in inputs.items():
            self.updated[name] = self.ticks
            if name in self.values:
                self.values[name] = value
        fraction = self.terminals.receive(inputs)
        if fraction is not None:
            self.pace.slider = min(max(fraction, 0.0), 1.0)

    def upload(self, script: Script) -> None:
        """Replace the running program; the new one starts after a short delay."""
        if self.safety is not SafetyMode.NORMAL or self.robot_mode is not RobotMode.RUNNING:
            self.log(f"program {script.name} refused: the robot is not ready ({self.robot_mode.name})")
            return
        if self.program is not None:
            self.end_program("replaced by an upload")
        self.last_script = script
        self._pending = (self.ticks + max(round(START_DELAY / self.period), 1), script)

    def play(self) -> bool:
        """Start the last program again, or resume a paused one; return False when there is none."""
        if self.safety is not SafetyMode.NORMAL or self.robot_mode is not RobotMode.RUNNING:
            return False
        if self.program is not None and self.runtime in {Runtime.PAUSED, Runtime.PAUSING}:
            self.runtime = Runtime.RESUMING
            self.pace.hold(False)
            return True
        if self.last_script is None:
            return False
        if self.program is None and self._pending is None:
            self.upload(self.last_script)
        return True

    def pause(self) -> bool:
        """Come to rest on the path and hold; return False when no program runs."""
        if self.program is None or self.runtime not in {Runtime.PLAYING, Runtime.RESUMING}:
            return False
        self.runtime = Runtime.PAUSING
        self.pace.hold(True)
        return True

    def end_program(self, reason: str) -> None:
        """End the program, if there is one; the arm comes to rest."""
        self._pending = None
        if self.program is None:
            return
        self.log(f"program ended: {reason}")
        self.program = None
        self.runtime = Runtime.STOPPING
        self.start_motion(Halt.of_joints(self.plan, PROGRAM_STOP))

    # Safety -------------------------------------------------------------------------------------

    def protective_stop(self, reason: str) -> None:
        """Stop the arm on its path; the program is paused until the stop is unlocked."""
        if self.safety is not SafetyMode.NORMAL:
            return
        self.log(f"protective stop: {reason}")
        self.safety, self.reason = SafetyMode.PROTECTIVE_STOP, reason
        self._stopped_at = self.ticks
        self.pace.hold(True, fast=True)
        if self.program is not None:
            self.runtime = Runtime.PAUSING

    def emergency_stop(self, reason: str) -> None:
        """Stop the arm, end its program and switch the power off."""
        self.log(f"emergency stop: {reason}")
        self.safety, self.reason = SafetyMode.EMERGENCY_STOP, reason
        self.pace.hold(True, fast=True)
        self._pending = None
        self.program = None
        self.runtime = Runtime.STOPPED
        self.robot_mode = RobotMode.POWER_OFF

    def unlock(self) -> bool:
        """Release a protective stop; return False when there is none. The program stays paused."""
        if self.safety is not SafetyMode.PROTECTIVE_STOP:
            return False
        self.safety, self.reason = SafetyMode.NORMAL, ""
        if self.program is None:
            self.motion, self.plan = None, Plan.resting(self.plan.q)
            self.pace.hold(False)
        return True

    def stop_duration(self) -> float:
        """Return the duration of the protective stop, s; infinite without one."""
        if self.safety is not SafetyMode.PROTECTIVE_STOP:
            return float("inf")
        return (self.ticks - self._stopped_at) * self.period

    def release_emergency_stop(self) -> None:
        """Release the emergency stop button; the power stays off."""
        if self.safety is SafetyMode.EMERGENCY_STOP:
            self.safety, self.reason = SafetyMode.NORMAL, ""

    def restart_safety(self) -> None:
        """Restart the safety system: normal mode, power off."""
        self.end_program("the safety system restarts")
        self.safety, self.reason = SafetyMode.NORMAL, ""
        self.power(RobotMode.POWER_OFF)

    def power(self, mode: RobotMode) -> None:
        """Switch power (POWER_OFF, IDLE) or release the brakes (RUNNING)."""
        if self.safety is SafetyMode.EMERGENCY_STOP and mode is not RobotMode.POWER_OFF:
            return
        if mode is RobotMode.POWER_OFF:
            self.end_program("power off")
        if mode is RobotMode.IDLE and self.robot_mode is RobotMode.RUNNING:
            return
        if mode is not RobotMode.RUNNING or self.robot_mode is not RobotMode.RUNNING:
            self.motion, self.plan = None, Plan.resting(self.plan.q)
            self.pace.hold(self.program is not None)
        self.robot_mode = mode

    def set_payload(self, mass: float, centre: Point, inertia: tuple[float, ...] = (0.0,) * 6) -> None:
        """Set the payload of the controller's model: mass, kg, centre, m, and inertia, kg·m²."""
        self.payload = (mass, centre)
        self.values |= {"payload": mass, "payload_cog": centre, "payload_inertia": inertia}
        self.arm.expect(mass, centre, self.gravity)

    # Motion -------------------------------------------------------------------------------------

    def start_motion(self, motion: Motion) -> Motion:
        """Start a motion, which replaces the present one."""
        self.motion = motion
        return motion

    def is_moving(self, motion: Motion | None) -> bool:
        """Return whether this motion is in progress."""
        return motion is not None and self.motion is motion

    def tick(self) -> None:
        """Simulate one period."""
        self.ticks += 1
        self._start_pending()
        self._update_runtime()
        if self.program is not None and self.runtime is Runtime.PLAYING:
            self.program.tick()
        self.plan = self._next_plan()
        reading = self.arm.step(self.plan, self.period)
        is_off = self.robot_mode is not RobotMode.RUNNING
        self.reading = reading._replace(current=np.zeros(6)) if is_off else reading
        self.history.append(self.reading.q)

    def publish(self, tool: bool = True) -> None:
        """Write all variables for this tick; it is slow, so that it is called only for readers."""
        publish(self, tool)

    def _start_pending(self) -> None:
        if self._pending is None or self._pending[0] > self.ticks or self.runtime is not Runtime.STOPPED:
            return
        script = self._pending[1]
        self._pending = None
        self.pace.hold(False)
        self.program = Program(self, script)
        self.runtime = Runtime.PLAYING
        self.log(f"program {script.name} runs")

    def _update_runtime(self) -> None:
        """End the states that last until the arm is at rest or at full speed."""
        if self.runtime is Runtime.STOPPING and (self.motion is None or self.pace.factor == 0.0):
            self.motion = None
            self.runtime = Runtime.STOPPED
            self.pace.hold(self.safety is not SafetyMode.NORMAL)
        elif self.runtime is Runtime.PAUSING and self.pace.factor == 0.0:
            self.runtime = Runtime.PAUSED
        elif self.runtime is Runtime.RESUMING and self.pace.resumed:
            self.runtime = Runtime.PLAYING

    def _next_plan(self) -> Plan:
        scale, change = self.pace.step(self.period)
        # while the pace changes, motion time advances by its mean
        motion_time = (scale - 0.5 * change * self.period) * self.period
        if self.motion is None or motion_time <= 0.0:
            return Plan.resting(self.plan.q)
        try:
            next_plan = self.motion.advance(motion_time)
            _check_limits(next_plan)
        except MotionError as error:
            return self._reject_motion(str(error))
        if self.motion.done:
            self.motion = None
        return Plan(next_plan.q, next_plan.qd * scale, next_plan.qdd * scale**2 + next_plan.qd * change)

    def _reject_motion(self, reason: str) -> Plan:
        """Stop the arm because its motion is impossible."""
        self.motion = Halt.of_joints(self.plan, PROGRAM_STOP * 2)
        self.protective_stop(reason)
        return Plan.resting(self.plan.q)


def _check_limits(plan: Plan) -> None:
    """Raise MotionError for a plan that exceeds a joint's range or speed."""
    if np.abs(plan.q).max() > JOINT_LIMIT + 1e-6:
        joint = int(np.abs(plan.q).argmax())
        raise MotionError(f"joint {joint} would leave its range of ±{JOINT_LIMIT:.3f} rad")
    if np.abs(plan.qd).max() > SPEED_LIMIT:
        raise MotionError(f"joint {int(np.abs(plan.qd).argmax())} would exceed {SPEED_LIMIT:g} rad/s")
