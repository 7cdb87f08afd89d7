"""What the unmodified client does with the twin of a UR5; run in a process of its own, which may hang or die.

    python ur5_calls.py HOST CHECK …

prints one line a check: its name and "ok", or what went wrong. Its exit status is 1 when anything did.
"""

from __future__ import annotations

import itertools
import math
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import dashboard_client
import rtde_control
import rtde_io
import rtde_receive

HOST = sys.argv[1]
HOME = [0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]
CHECKS: dict[str, Callable[[], None]] = {}
SINCE = {"state_queries_of_e_series": (5, 11), "dashboard_of_e_series": (5, 6), "dynamics_of_5_23": (5, 23)}
"""Checks that need a controller of some version."""


def check(function: Callable[[], None]) -> Callable[[], None]:
    CHECKS[function.__name__] = function
    return function


class Robot:
    """The client's interfaces, made when they are first asked for."""

    def __getattr__(self, name: str) -> object:
        made = {
            "control": lambda: rtde_control.RTDEControlInterface(HOST),
            "receive": lambda: rtde_receive.RTDEReceiveInterface(HOST),
            "io": lambda: rtde_io.RTDEIOInterface(HOST),
            "dashboard": self._dashboard,
        }[name]()
        setattr(self, name, made)
        return made

    def _dashboard(self) -> object:
        client = dashboard_client.DashboardClient(HOST)
        client.connect()
        return client


robot = Robot()


def near(found: list[float], wanted: list[float], within: float) -> None:
    assert len(found) == len(wanted), (found, wanted)
    assert max(abs(a - b) for a, b in zip(found, wanted, strict=True)) < within, (found, wanted)


def eventually(true: Callable[[], bool], within: float = 10.0) -> None:
    deadline = time.monotonic() + within
    while not true():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.002)


def near_pose(found: list[float], wanted: list[float], within: float) -> None:
    """The same pose; a rotation by half a turn has two vectors."""
    near(found[:3], wanted[:3], within)
    near([abs(x) for x in found[3:]], [abs(x) for x in wanted[3:]], within)


def restart() -> None:
    """Begin the program anew; a command that the dead one was given would be carried out again."""
    robot.control.kickWatchdog()
    assert robot.control.reuploadScript()
    eventually(robot.control.isProgramRunning)


def settle() -> None:
    eventually(lambda: max(map(abs, robot.receive.getTargetQd())) == 0.0)


def home() -> None:
    assert robot.control.moveJ(HOME, 2.0, 6.0)
    settle()


@check
def receive_every_getter() -> None:
    r = robot.receive
    near(r.getActualQ(), r.getTargetQ(), 0.01)
    assert len(r.getActualQd()) == len(r.getTargetQd()) == len(r.getTargetQdd()) == 6
    assert max(map(abs, r.getTargetCurrent())) > 0.5, "weight asks for current"
    assert max(map(abs, r.getActualCurrent())) > 0.5
    assert max(map(abs, r.getTargetMoment())) > 5.0
    assert len(r.getJointControlOutput()) == len(r.getActualTCPForce()) == len(r.getActualTCPSpeed()) == 6
    near_pose(r.getActualTCPPose(), r.getTargetTCPPose(), 0.01)
    assert len(r.getTargetTCPSpeed()) == 6
    assert r.getActualDigitalInputBits() == 0
    assert all(20.0 < t < 60.0 for t in r.getJointTemperatures())
    assert r.getActualExecutionTime() >= 0.0
    assert (r.getRobotMode(), r.getSafetyMode()) == (7, 1)
    assert list(r.getJointMode()) == [253] * 6
    assert abs(math.dist(r.getActualToolAccelerometer(), (0, 0, 0)) - 9.81) < 2.0
    assert (r.getSpeedScaling(), r.getTargetSpeedFraction()) == (1.0, 1.0)
    assert r.getActualMomentum() >= 0.0
    assert 40.0 < r.getActualMainVoltage() < 50.0
    assert 40.0 < r.getActualRobotVoltage() < 50.0
    assert r.getActualRobotCurrent() > 0.0
    assert all(40.0 < v < 50.0 for v in r.getActualJointVoltage())
    assert r.getActualDigitalOutputBits() >= 0
    assert r.getRuntimeState() in (1, 2)
    assert r.getStandardAnalogInput0() == r.getStandardAnalogInput1() == 0.0
    assert r.getRobotStatus() & 1
    assert r.getSafetyStatusBits() == 1
    assert r.getOutputIntRegister(12) == 0
    assert r.getOutputDoubleRegister(19) == 0.0
    assert len(r.getPayloadInertia()) == 6
    assert len(r.getPayloadCog()) == 3
    assert r.getPayload() == 0.0
    assert not r.isProtectiveStopped()
    assert not r.isEmergencyStopped()
    assert r.getSpeedScalingCombined() == 1.0
    before = r.getTimestamp()
    eventually(lambda: r.getTimestamp() > before)


@check
def receive_subset_and_unknown() -> None:
    some = rtde_receive.RTDEReceiveInterface(HOST, 50.0, ["timestamp", "actual_q"])
    near(some.getActualQ(), robot.receive.getActualQ(), 0.05)
    times = []
    for _ in range(20):
        last = some.getTimestamp()
        eventually(lambda last=last: some.getTimestamp() > last)
        times.append(some.getTimestamp())
    assert all(
        round((b - a) / 0.008) % round(0.02 / 0.008) in (0, 1, 2) for a, b in itertools.pairwise(times)
    )
    some.disconnect()
    try:
        rtde_receive.RTDEReceiveInterface(HOST, 50.0, ["timestamp", "no_such_thing"])
    except RuntimeError as error:
        assert "no_such_thing" in str(error)
    else:
        raise AssertionError("an unknown variable was accepted")


@check
def receive_reconnect() -> None:
    other = rtde_receive.RTDEReceiveInterface(HOST)
    other.disconnect()
    assert not other.isConnected()
    assert other.reconnect()
    before = other.getTimestamp()
    eventually(lambda: other.getTimestamp() > before)
    other.disconnect()


@check
def move_joints() -> None:
    target = [0.3, -1.4, 1.4, -1.5, -1.4, 0.2]
    assert robot.control.moveJ(target, 1.5, 4.0)
    settle()
    near(robot.receive.getTargetQ(), target, 1e-9)
    eventually(lambda: math.dist(robot.receive.getActualQ(), target) < 0.01)


@check
def move_joints_to_pose() -> None:
    home()
    pose = robot.receive.getTargetTCPPose()
    pose[2] += 0.05
    assert robot.control.moveJ_IK(pose, 1.5, 4.0)
    settle()
    near_pose(robot.receive.getTargetTCPPose(), pose, 1e-6)


@check
def move_line() -> None:
    home()
    pose = robot.receive.getTargetTCPPose()
    pose[1] -= 0.1
    start = robot.receive.getTargetTCPPose()
    assert robot.control.moveL(pose, 0.5, 2.0, True)
    worst = 0.0
    while robot.control.getAsyncOperationProgress() >= 0:
        now = robot.receive.getTargetTCPPose()
        worst = max(worst, abs(now[0] - start[0]), abs(now[2] - start[2]))
    settle()
    near_pose(robot.receive.getTargetTCPPose(), pose, 1e-6)
    assert worst < 1e-6, "the way was no straight line"


@check
def move_line_to_joints() -> None:
    home()
    target = [0.05, -1.5, 1.5, -1.55, -1.55, 0.05]
    assert robot.control.moveL_FK(target, 0.5, 2.0)
    settle()
    near(robot.receive.getTargetQ(), target, 1e-6)


@check
def asynchronous_progress() -> None:
    home()
    before = robot.control.getAsyncOperationProgressEx().operationId()
    assert robot.control.moveJ([0.5, *HOME[1:]], 1.0, 3.0, True)
    eventually(lambda: robot.control.getAsyncOperationProgressEx().isAsyncOperationRunning())
    assert robot.control.getAsyncOperationProgress() == 0
    assert robot.control.getAsyncOperationProgressEx().operationId() == (before + 1) % 128
    eventually(lambda: not robot.control.getAsyncOperationProgressEx().isAsyncOperationRunning())
    # the two connections are not in step
    settle()
    near(robot.receive.getTargetQ(), [0.5, *HOME[1:]], 1e-9)


@check
def stop_asynchronous_move() -> None:
    for stop in (robot.control.stopJ, robot.control.stopL):
        home()
        assert robot.control.moveJ([1.5, *HOME[1:]], 1.0, 3.0, True)
        eventually(lambda: robot.receive.getTargetQd()[0] > 0.5)
        stop(5.0)
        settle()
        assert 0.0 < robot.receive.getTargetQ()[0] < 1.4
    home()
    assert robot.control.moveJ([1.5, *HOME[1:]], 1.0, 3.0, True)
    eventually(lambda: robot.receive.getTargetQd()[0] > 0.5)
    robot.control.stopJ(3.0, True)
    settle()


@check
def path_of_joints() -> None:
    home()
    corner, end = [0.3, -1.4, 1.5, -1.5, -1.5, 0.1], [0.5, -1.5, 1.4, -1.5, -1.5, 0.0]
    path = [[*corner, 1.0, 3.0, 0.02], [*end, 1.0, 3.0, 0.0]]
    assert robot.control.moveJ(path)
    settle()
    near(robot.receive.getTargetQ(), end, 1e-5)


@check
def path_of_lines_with_progress() -> None:
    home()
    start = robot.receive.getTargetTCPPose()
    corner, end = list(start), list(start)
    corner[2] += 0.05
    end[1], end[2] = end[1] + 0.05, end[2] + 0.05
    assert robot.control.moveL([[*corner, 0.06, 1.0, 0.01], [*end, 0.06, 1.0, 0.0]], True)
    seen = set()
    while robot.control.getAsyncOperationProgressEx().isAsyncOperationRunning() or not seen:
        seen.add(robot.control.getAsyncOperationProgress())
    assert {0, 1} <= seen, seen
    settle()
    near_pose(robot.receive.getTargetTCPPose(), end, 1e-4)


@check
def path_of_both() -> None:
    home()
    path = rtde_control.Path()
    entry = rtde_control.PathEntry
    path.addEntry(entry(entry.MoveJ, entry.PositionJoints, [0.2, *HOME[1:], 1.0, 3.0, 0.0]))
    pose = robot.control.getForwardKinematics([0.2, *HOME[1:]], [0.0] * 6)
    pose = list(robot.receive.getTargetTCPPose())
    pose[2] += 0.03
    path.addEntry(entry(entry.MoveL, entry.PositionTcpPose, [*pose, 0.25, 1.0, 0.0]))
    assert robot.control.movePath(path, False)
    settle()
    near_pose(robot.receive.getTargetTCPPose(), pose, 1e-4)


@check
def servo_joints() -> None:
    home()
    dt = 1.0 / 125.0
    furthest = 0.0
    for k in range(125):
        begin = robot.control.initPeriod()
        q = [0.2 * (1.0 - math.cos(2.0 * math.pi * k * dt)), *HOME[1:]]
        assert robot.control.servoJ(q, 0.0, 0.0, dt, 0.03, 2000.0)
        furthest = max(furthest, robot.receive.getActualQ()[0])
        robot.control.waitPeriod(begin)
    assert robot.control.servoStop()
    settle()
    assert 0.3 < furthest < 0.45, furthest


@check
def servo_pose_and_circular() -> None:
    home()
    pose = robot.receive.getTargetTCPPose()
    pose[2] += 0.03
    for _ in range(100):
        assert robot.control.servoL(pose, 0.0, 0.0, 0.008, 0.05, 1000.0)
        time.sleep(0.01)
    assert robot.control.servoStop()
    near_pose(robot.receive.getTargetTCPPose(), pose, 1e-3)
    pose[2] -= 0.03
    assert robot.control.servoC(pose, 0.1, 0.5)
    eventually(lambda: math.dist(robot.receive.getTargetTCPPose()[:3], pose[:3]) < 1e-3)
    # the client does not clear this command, so that its next call finds the program busy and gives up
    assert not robot.control.servoStop()
    assert robot.control.servoStop()


@check
def speed_joints() -> None:
    home()
    assert robot.control.speedJ([0.3, 0, 0, 0, 0, 0.1], 1.0)
    eventually(lambda: robot.receive.getTargetQd()[0] == 0.3)
    assert abs(robot.receive.getTargetQd()[5] - 0.1) < 1e-9
    eventually(lambda: abs(robot.receive.getActualQd()[0] - 0.3) < 0.03)
    assert robot.control.speedStop()
    settle()


@check
def speed_tool() -> None:
    home()
    assert robot.control.speedL([0, 0, 0.05, 0, 0, 0], 0.5)
    eventually(lambda: abs(robot.receive.getTargetTCPSpeed()[2] - 0.05) < 1e-3)
    assert robot.control.speedStop()
    settle()


@check
def jog() -> None:
    home()
    for feature in (
        rtde_control.RTDEControlInterface.FEATURE_BASE,
        rtde_control.RTDEControlInterface.FEATURE_TOOL,
    ):
        assert robot.control.jogStart([0, 0, 0.04, 0, 0, 0], int(feature))
        eventually(lambda: math.dist(robot.receive.getTargetTCPSpeed()[:3], (0, 0, 0)) > 0.035)
        assert robot.control.jogStop()
        settle()


@check
def kinematics() -> None:
    home()
    control, receive = robot.control, robot.receive
    near_pose(control.getForwardKinematics(), receive.getActualTCPPose(), 1e-3)
    q = [0.2, -1.2, 1.1, -1.3, -1.4, 0.3]
    pose = control.getForwardKinematics(q, [0.0, 0.0, 0.1, 0.0, 0.0, 0.001])
    flange = control.poseTrans(pose, [0.0, 0.0, -0.1, 0.0, 0.0, -0.001])
    near(control.getInverseKinematics(flange, q), q, 1e-4)
    near(control.getInverseKinematics(receive.getTargetTCPPose()), receive.getTargetQ(), 1e-6)
    assert control.getInverseKinematicsHasSolution(flange)
    assert control.getInverseKinematicsHasSolution(flange, q)
    assert not control.getInverseKinematicsHasSolution([5.0, 0, 0, 0, 0, 0])
    assert control.isPoseWithinSafetyLimits(flange)
    assert not control.isPoseWithinSafetyLimits([5.0, 0, 0, 0, 0, 0])
    assert control.isJointsWithinSafetyLimits(q)
    assert not control.isJointsWithinSafetyLimits([7.0, 0, 0, 0, 0, 0])


@check
def tool_and_payload() -> None:
    control, receive = robot.control, robot.receive
    home()
    offset = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    # the client does not wait for the answer to this command: its first answer is an old one
    eventually(
        lambda: math.dist(control.getActualToolFlangePose()[:3], receive.getActualTCPPose()[:3]) < 1e-3
    )
    bare = control.getActualToolFlangePose()
    assert control.setTcp(offset)
    near(control.getTCPOffset(), offset, 1e-12)
    eventually(lambda: abs(math.dist(receive.getActualTCPPose()[:3], bare[:3]) - 0.1) < 1e-3)
    assert control.setTcp([0.0] * 6)
    weight = receive.getTargetMoment()[1]
    assert control.setPayload(2.0, [0.0, 0.0, 0.05])
    eventually(lambda: abs(receive.getTargetMoment()[1] - weight) > 3.0)
    assert receive.getPayload() == 2.0
    near(receive.getPayloadCog(), [0.0, 0.0, 0.05], 1e-9)
    eventually(lambda: receive.getActualTCPForce()[2] > 10.0)
    assert control.setPayload(0.0, [0.0, 0.0, 0.0])
    assert control.setGravity([0.0, 0.0, 9.81])
    eventually(lambda: abs(receive.getActualTCPForce()[2]) < 5.0)


@check
def state_queries() -> None:
    control = robot.control
    home()
    eventually(control.isSteady)
    assert control.isProgramRunning()
    assert control.isConnected()
    assert control.getRobotStatus() & 2
    torques = control.getJointTorques()
    assert len(torques) == 6
    time.sleep(0.1)
    assert max(map(abs, control.getJointTorques())) > 5.0
    assert control.zeroFtSensor()
    assert control.kickWatchdog()


@check
def state_queries_of_e_series() -> None:
    control = robot.control
    home()
    control.getStepTime()
    time.sleep(0.05)
    assert abs(control.getStepTime() - 0.002) < 1e-9
    control.getActualJointPositionsHistory(5)
    time.sleep(0.05)
    near(control.getActualJointPositionsHistory(5), HOME, 0.01)
    near_pose(control.getTargetWaypoint(), robot.receive.getTargetTCPPose(), 1e-6)
    assert control.getFreedriveStatus() == 0
    assert control.toolContact([0.0] * 6) >= 0
    assert control.setTargetPayload(1.0, [0.0, 0.0, 0.02], [0.0] * 6)
    eventually(lambda: robot.receive.getPayload() == 1.0)
    assert control.setTargetPayload(0.0, [0.0, 0.0, 0.01], [0.0] * 6)
    assert len(robot.receive.getFtRawWrench()) == 6


@check
def accepted_without_effect() -> None:
    control = robot.control
    home()
    nothing = [0.0] * 6
    assert control.forceMode(nothing, [0, 0, 1, 0, 0, 0], nothing, 2, [0.1] * 6)
    assert control.forceModeStop()
    assert control.forceModeSetDamping(0.1)
    assert control.forceModeSetGainScaling(1.0)
    assert control.teachMode()
    assert control.endTeachMode()
    assert control.freedriveMode([1] * 6, nothing)
    assert control.endFreedriveMode()
    assert control.ftRtdeInputEnable(True, 0.0, [0.0] * 3, [0.0] * 3)
    assert control.enableExternalFtSensor(False, 0.0, [0.0] * 3, [0.0] * 3)
    assert control.setExternalForceTorque(nothing)
    assert control.startContactDetection(nothing)
    assert not control.readContactDetection()
    assert not control.stopContactDetection()


@check
def dynamics_of_5_23() -> None:
    control = robot.control
    home()
    # the client waits for one package, not for the answer
    eventually(lambda: min(control.getMassMatrix([], False)[::7]) > 0.0)
    masses = control.getMassMatrix([], False)
    assert len(masses) == 36
    for i in range(6):
        assert masses[7 * i] > 0.0
        for j in range(6):
            assert abs(masses[6 * i + j] - masses[6 * j + i]) < 1e-9
    # joint 0 turns about the vertical
    eventually(lambda: abs(control.getJacobian([], [])[5] - 1.0) < 1e-6)
    assert len(control.getJacobianTimeDerivative([], [], [])) == 36
    assert len(control.getCoriolisAndCentrifugalTorques([], [])) == 6
    eventually(lambda: control.getTargetJointAccelerations() == [0.0] * 6)
    assert len(robot.receive.getActualQ()) == 6
    assert control.directTorque([0.0] * 6, [], [])


@check
def programs() -> None:
    control = robot.control
    control.stopScript()
    assert not control.isProgramRunning()
    assert not control.moveJ(HOME, 1.0, 1.0)
    restart()
    restart()
    home()


@check
def custom_program() -> None:
    home()
    script = (
        "set_standard_digital_out(3, True)\nmovej([0.2, -1.5, 1.5, -1.5, -1.5, 0], a=3, v=1)\nsleep(0.05)"
    )
    assert robot.control.sendCustomScriptFunction("custom", script)
    near(robot.receive.getTargetQ(), [0.2, -1.5, 1.5, -1.5, -1.5, 0.0], 1e-6)
    assert robot.receive.getActualDigitalOutputBits() >> 3 & 1
    home()


@check
def custom_scripts_in_place_of_the_program() -> None:
    home()
    script = (
        "def mine():\n\tmovej([0.1, -1.5, 1.5, -1.5, -1.5, 0], a=3, v=1)\n"
        "\twrite_output_integer_register(0, 2)\nend\n"
    )
    assert robot.control.sendCustomScript(script)
    near(robot.receive.getTargetQ(), [0.1, -1.5, 1.5, -1.5, -1.5, 0.0], 1e-6)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mine.script"
        file.write_text(script.replace("[0.1", "[0.2"))
        assert robot.control.sendCustomScriptFile(str(file))
    near(robot.receive.getTargetQ(), [0.2, -1.5, 1.5, -1.5, -1.5, 0.0], 1e-6)
    assert robot.control.isProgramRunning()
    home()


@check
def receive_into_a_file() -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.csv"
        assert robot.receive.startFileRecording(str(file), ["timestamp", "actual_q"])
        time.sleep(0.5)
        assert robot.receive.stopFileRecording()
        rows = file.read_text().splitlines()
    assert rows[0].split(",")[:2] == ["timestamp", "actual_q_0"]
    assert len(rows) > 10
    assert len({row.split(",")[0] for row in rows[1:]}) > 10
    assert not robot.receive.getDigitalInState(0)


@check
def pose_out_of_reach_ends_the_program() -> None:
    control = robot.control
    home()
    assert not control.moveJ_IK([5.0, 0, 0, 0, 0, 0], 1.0, 1.0)
    assert not control.isProgramRunning()
    restart()


@check
def protective_stop_and_unlock() -> None:
    control, receive = robot.control, robot.receive
    home()
    assert control.moveJ([1.5, *HOME[1:]], 1.0, 3.0, True)
    eventually(lambda: receive.getTargetQd()[0] > 0.5)
    control.triggerProtectiveStop()
    eventually(receive.isProtectiveStopped)
    assert receive.getSafetyMode() == 3
    settle()
    assert not control.moveJ(HOME, 1.0, 1.0)
    try:
        robot.dashboard.unlockProtectiveStop()
    except (RuntimeError, ValueError):
        pass
    else:
        raise AssertionError("a stop was unlocked at once")
    time.sleep(0.5)
    robot.dashboard.unlockProtectiveStop()
    eventually(lambda: not receive.isProtectiveStopped())
    restart()
    home()


@check
def joint_range_stops_the_arm() -> None:
    home()
    assert robot.control.moveJ([6.2, *HOME[1:]], 3.1, 20.0)
    assert robot.control.speedJ([1.0, 0, 0, 0, 0, 0], 5.0)
    eventually(robot.receive.isProtectiveStopped)
    settle()
    assert robot.receive.getTargetQ()[0] < 6.3
    time.sleep(0.5)
    robot.dashboard.unlockProtectiveStop()
    eventually(lambda: not robot.receive.isProtectiveStopped())
    restart()
    assert robot.control.moveJ(HOME, 3.1, 10.0)


@check
def watchdog_ends_the_program() -> None:
    control = robot.control
    home()
    assert control.setWatchdog(20.0)
    assert control.speedJ([0.2, 0, 0, 0, 0, 0], 1.0)
    for _ in range(20):
        assert control.speedJ([0.2, 0, 0, 0, 0, 0], 1.0)
        time.sleep(0.01)
    assert control.isProgramRunning()
    eventually(lambda: not control.isProgramRunning())
    settle()
    restart()
    home()


@check
def two_motions_at_once_end_the_program() -> None:
    control = robot.control
    home()
    assert control.servoJ(HOME, 0.0, 0.0, 0.008, 0.1, 300.0)
    time.sleep(0.05)
    assert not control.moveJ([0.1, *HOME[1:]], 1.0, 1.0)
    restart()
    home()


@check
def io_outputs() -> None:
    io, receive = robot.io, robot.receive
    assert io.isConnected()
    assert io.setStandardDigitalOut(2, True)
    assert io.setConfigurableDigitalOut(1, True)
    assert io.setToolDigitalOut(0, True)
    eventually(
        lambda: (
            receive.getActualDigitalOutputBits() & (1 << 2 | 1 << 9 | 1 << 16) == 1 << 2 | 1 << 9 | 1 << 16
        )
    )
    assert receive.getDigitalOutState(2)
    assert io.setStandardDigitalOut(2, False)
    assert io.setConfigurableDigitalOut(1, False)
    assert io.setToolDigitalOut(0, False)
    eventually(lambda: not receive.getActualDigitalOutputBits() & (1 << 2 | 1 << 9 | 1 << 16))
    assert io.setAnalogOutputVoltage(0, 0.5)
    assert io.setAnalogOutputCurrent(1, 0.25)
    eventually(lambda: abs(receive.getStandardAnalogOutput0() - 5.0) < 1e-9)
    eventually(lambda: abs(receive.getStandardAnalogOutput1() - 0.008) < 1e-9)
    assert io.setInputIntRegister(19, 42)
    assert io.setInputDoubleRegister(20, 2.5)
    some = rtde_receive.RTDEReceiveInterface(HOST, 50.0, ["timestamp"])
    some.disconnect()


@check
def speed_slider() -> None:
    io, receive = robot.io, robot.receive
    home()
    assert io.setSpeedSlider(0.3)
    eventually(lambda: abs(receive.getSpeedScaling() - 0.3) < 1e-9)
    assert abs(receive.getTargetSpeedFraction() - 0.3) < 1e-9
    assert robot.control.moveJ([0.4, *HOME[1:]], 1.0, 4.0, True)
    fastest = 0.0
    while not fastest or robot.control.getAsyncOperationProgressEx().isAsyncOperationRunning():
        fastest = max(fastest, receive.getTargetQd()[0])
    assert 0.25 < fastest < 0.31, fastest
    assert io.setSpeedSlider(1.0)
    eventually(lambda: receive.getSpeedScaling() == 1.0)


@check
def dashboard_answers() -> None:
    d, control = robot.dashboard, robot.control
    eventually(control.isProgramRunning)
    assert d.isConnected()
    assert d.running()
    assert d.programState().startswith("PLAYING")
    assert d.robotmode() == "Robotmode: RUNNING"
    assert d.safetymode() == "Safetymode: NORMAL"
    assert d.safetystatus() == "Safetystatus: NORMAL"
    assert d.getRobotModel() == "UR5"
    assert d.polyscopeVersion().count(".") == 3
    assert d.isProgramSaved()
    d.popup("hello")
    d.closePopup()
    d.closeSafetyPopup()
    d.addToLog("a line")
    d.setUserRole(dashboard_client.UserRole.NONE) if hasattr(dashboard_client, "UserRole") else None
    d.pause()
    eventually(lambda: robot.receive.getRuntimeState() == 4)
    assert not d.running()
    d.play()
    eventually(control.isProgramRunning)
    d.stop()
    eventually(lambda: not control.isProgramRunning())
    d.loadURP("some.urp")
    assert "some.urp" in d.getLoadedProgram()
    d.play()
    eventually(control.isProgramRunning)
    home()


@check
def dashboard_of_e_series() -> None:
    assert robot.dashboard.getSerialNumber().isdigit()
    assert robot.dashboard.isInRemoteControl()


@check
def power_cycle() -> None:
    d, receive = robot.dashboard, robot.receive
    home()
    d.powerOff()
    eventually(lambda: receive.getRobotMode() == 3)
    assert receive.getActualCurrent() == [0.0] * 6
    d.powerOn()
    eventually(lambda: receive.getRobotMode() == 5)
    d.brakeRelease()
    eventually(lambda: receive.getRobotMode() == 7)
    d.restartSafety()
    eventually(lambda: receive.getRobotMode() == 3)
    d.powerOn()
    d.brakeRelease()
    eventually(lambda: receive.getRobotMode() == 7)
    restart()
    home()


@check
def registers_in_use() -> None:
    assert robot.control.isConnected()
    try:
        rtde_control.RTDEControlInterface(HOST)
    except RuntimeError as error:
        assert "in use" in str(error)
    else:
        raise AssertionError("two clients have the same inputs")
    upper = rtde_control.RTDEControlInterface
    flags = upper.FLAG_UPPER_RANGE_REGISTERS | upper.FLAG_NO_EXT_FT | upper.FLAG_NO_WAIT
    second = upper(HOST, -1.0, flags)
    second.disconnect()
    robot.control.disconnect()
    robot.control = rtde_control.RTDEControlInterface(HOST)
    home()


@check
def upper_registers() -> None:
    if "control" in vars(robot):
        robot.control.disconnect()
        del robot.control
    interface = rtde_control.RTDEControlInterface
    control = interface(HOST, -1.0, interface.FLAG_UPLOAD_SCRIPT | interface.FLAG_UPPER_RANGE_REGISTERS)
    assert control.moveJ([0.1, *HOME[1:]], 2.0, 5.0)
    near_pose(control.getForwardKinematics(), robot.receive.getActualTCPPose(), 1e-3)
    control.disconnect()


def _for_this_version() -> list[str]:
    major, minor = (int(part) for part in robot.dashboard.polyscopeVersion().split(".")[:2])
    return [name for name in CHECKS if (major, minor) >= SINCE.get(name, (0, 0))]


def main() -> int:
    bad = 0
    for name in sys.argv[2:] or _for_this_version():
        try:
            CHECKS[name]()
            said = "ok"
        except Exception as error:  # noqa: BLE001 - the line says what went wrong
            bad += 1
            where = traceback.extract_tb(error.__traceback__)[1]
            said = f"{type(error).__name__} at line {where.lineno} ({where.line}): {error}"
        print(f"{name}: {said}", flush=True)
    for interface in list(vars(robot).values()):
        interface.disconnect()
    return min(bad, 1)


if __name__ == "__main__":
    sys.exit(main())
