"""The controller: modes, program, motion and variables, one tick after the other.

Everything here is used by one thread, the server's, so that no state is ever half changed.
"""

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
"""s from the upload of a program to its start."""
PROGRAM_STOP = 8.0
"""rad/s² with which the arm comes to rest when its program ends in motion."""
HISTORY = 1000
"""How many ticks of joint angles are kept (``get_actual_joint_positions_history``)."""

Log = Callable[[str], None]


class Controller:
    """One arm with its controller; ``tick`` lets one period pass."""

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
        self.history: deque[FloatArray] = deque(maxlen=HISTORY)
        self.ticks = 0
        self.updated: dict[str, int] = {}
        self.contact = 0
        """What ``tool_contact`` says: how many ticks ago something was touched, 0 for nothing."""
        self.gravity: Point = GRAVITY
        self.force_zero = np.zeros(6)
        self.force_at = 0
        self.arm = arm
        self._pending: tuple[int, Script] | None = None
        self._stopped_at = 0
        arm.place(home.q)
        self.reading = arm.step(home, self.period)

    # What clients ask for -----------------------------------------------------------------------

    def receive(self, inputs: Mapping[str, Value]) -> None:
        """Take over what a client has set."""
        for name, value in inputs.items():
            self.updated[name] = self.ticks
            if name in self.values:
                self.values[name] = value
        fraction = self.terminals.receive(inputs)
        if fraction is not None:
            self.pace.slider = min(max(fraction, 0.0), 1.0)

    def upload(self, script: Script) -> None:
        """Take a program: it replaces the one that runs and begins a moment later."""
        if self.safety is not SafetyMode.NORMAL or self.robot_mode is not RobotMode.RUNNING:
            self.log(f"program {script.name} refused: the robot is not ready ({self.robot_mode.name})")
            return
        if self.program is not None:
            self.end_program("replaced by an upload")
        self.last_script = script
        self._pending = (self.ticks + max(round(START_DELAY / self.period), 1), script)

    def play(self) -> bool:
        """Begin the last program again, or go on with a paused one; False when there is none."""
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
        """Slow down along the way to rest and stay there; False when no program runs."""
        if self.program is None or self.runtime not in {Runtime.PLAYING, Runtime.RESUMING}:
            return False
        self.runtime = Runtime.PAUSING
        self.pace.hold(True)
        return True

    def end_program(self, why: str) -> None:
        """End the program, if there is one; the arm comes to rest."""
        self._pending = None
        if self.program is None:
            return
        self.log(f"program ended: {why}")
        self.program = None
        self.runtime = Runtime.STOPPING
        self.begin(Halt.of_joints(self.plan, PROGRAM_STOP))

    # Safety -------------------------------------------------------------------------------------

    def protective_stop(self, why: str) -> None:
        """Stop the arm along its way; the program is paused until somebody unlocks the stop."""
        if self.safety is not SafetyMode.NORMAL:
            return
        self.log(f"protective stop: {why}")
        self.safety, self.reason = SafetyMode.PROTECTIVE_STOP, why
        self._stopped_at = self.ticks
        self.pace.hold(True, at_once=True)
        if self.program is not None:
            self.runtime = Runtime.PAUSING

    def emergency_stop(self, why: str) -> None:
        """Stop the arm, end its program, take the power off."""
        self.log(f"emergency stop: {why}")
        self.safety, self.reason = SafetyMode.EMERGENCY_STOP, why
        self.pace.hold(True, at_once=True)
        self._pending = None
        self.program = None
        self.runtime = Runtime.STOPPED
        self.robot_mode = RobotMode.POWER_OFF

    def unlock(self) -> bool:
        """Release a protective stop; False when there is none. The program stays paused."""
        if self.safety is not SafetyMode.PROTECTIVE_STOP:
            return False
        self.safety, self.reason = SafetyMode.NORMAL, ""
        if self.program is None:
            self.motion, self.plan = None, Plan.resting(self.plan.q)
            self.pace.hold(False)
        return True

    def stopped_for(self) -> float:
        """How long (s) a protective stop has held; infinite without one."""
        if self.safety is not SafetyMode.PROTECTIVE_STOP:
            return float("inf")
        return (self.ticks - self._stopped_at) * self.period

    def restore(self) -> None:
        """Release the emergency stop's button; the power stays off."""
        if self.safety is SafetyMode.EMERGENCY_STOP:
            self.safety, self.reason = SafetyMode.NORMAL, ""

    def restart_safety(self) -> None:
        """Begin the safety system again: everything normal, power off."""
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

    def carry(self, mass: float, centre: Point, inertia: tuple[float, ...] = (0.0,) * 6) -> None:
        """Believe that the flange carries this (kg, m, kg·m²)."""
        self.payload = (mass, centre)
        self.values |= {"payload": mass, "payload_cog": centre, "payload_inertia": inertia}
        self.arm.expect(mass, centre, self.gravity)

    # Motion -------------------------------------------------------------------------------------

    def begin(self, motion: Motion) -> Motion:
        """Let a motion begin now; it replaces the one that goes on."""
        self.motion = motion
        return motion

    def moving(self, motion: Motion | None) -> bool:
        """Tell whether this motion still goes on."""
        return motion is not None and self.motion is motion

    def tick(self) -> None:
        """Let one period pass."""
        self.ticks += 1
        self._start_pending()
        self._settle_runtime()
        if self.program is not None and self.runtime is Runtime.PLAYING:
            self.program.tick()
        self.plan = self._next_plan()
        reading = self.arm.step(self.plan, self.period)
        off = self.robot_mode is not RobotMode.RUNNING
        self.reading = reading._replace(current=np.zeros(6)) if off else reading
        self.history.append(self.reading.q)

    def publish(self, tool: bool = True) -> None:
        """Write all variables for this tick: only where somebody reads them, for it takes its time."""
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

    def _settle_runtime(self) -> None:
        """States that last as long as the arm needs."""
        if self.runtime is Runtime.STOPPING and (self.motion is None or self.pace.now == 0.0):
            self.motion = None
            self.runtime = Runtime.STOPPED
            self.pace.hold(self.safety is not SafetyMode.NORMAL)
        elif self.runtime is Runtime.PAUSING and self.pace.now == 0.0:
            self.runtime = Runtime.PAUSED
        elif self.runtime is Runtime.RESUMING and self.pace.resumed:
            self.runtime = Runtime.PLAYING

    def _next_plan(self) -> Plan:
        scale, change = self.pace.step(self.period)
        # while the pace changes, its mean passed
        passed = (scale - 0.5 * change * self.period) * self.period
        if self.motion is None or passed <= 0.0:
            return Plan.resting(self.plan.q)
        try:
            ahead = self.motion.advance(passed)
            _within_limits(ahead)
        except MotionError as error:
            return self._refuse(str(error))
        if self.motion.done:
            self.motion = None
        return Plan(ahead.q, ahead.qd * scale, ahead.qdd * scale**2 + ahead.qd * change)

    def _refuse(self, why: str) -> Plan:
        """A motion cannot be: stop by the shortest way, and say why."""
        self.motion = Halt.of_joints(self.plan, PROGRAM_STOP * 2)
        self.protective_stop(why)
        return Plan.resting(self.plan.q)


def _within_limits(plan: Plan) -> None:
    """Raise MotionError for a plan beyond the joints' ranges or speeds."""
    if np.abs(plan.q).max() > JOINT_LIMIT + 1e-6:
        joint = int(np.abs(plan.q).argmax())
        raise MotionError(f"joint {joint} would leave its range of ±{JOINT_LIMIT:.3f} rad")
    if np.abs(plan.qd).max() > SPEED_LIMIT:
        raise MotionError(f"joint {int(np.abs(plan.qd).argmax())} would exceed {SPEED_LIMIT:g} rad/s")
