"""The twin's kinematics and its motions, without a wire."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.plants.arm.links import UR3E, UR5, UR10E
from labhil_sim_ur5.following import JointSpeed, Servo, ToolSpeed
from labhil_sim_ur5.kinematics import Geometry
from labhil_sim_ur5.motion import Halt, JointMove, LineMove, Motion, MotionError, Plan
from labhil_sim_ur5.paths import Path
from labhil_sim_ur5.poses import angle_between, inverse, pose_times, rotation_of, vector_of

ARM = Geometry.from_links(UR5)
HOME = np.array([0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0])


def denavit_hartenberg(links, q):
    """The tool's frame as a product of the table's rows."""
    frame = np.eye(4)
    for link, angle in zip(links.links, q, strict=True):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(link.alpha), np.sin(link.alpha)
        turn = [[c, -s * ca, s * sa, link.a * c], [s, c * ca, -c * sa, link.a * s]]
        frame = frame @ np.array([*turn, [0, sa, ca, link.d], [0, 0, 0, 1]])
    return frame


def run(motion: Motion, h: float = 0.002, most: int = 20000) -> list[Plan]:
    """All plans of a motion until it is done."""
    plans = []
    while not motion.done:
        plans.append(motion.advance(h))
        assert len(plans) < most
    return plans


@pytest.mark.parametrize("links", [UR5, UR3E, UR10E], ids=lambda links: links.name)
def test_forward_inverse_and_jacobian_agree(links) -> None:
    arm, random = Geometry.from_links(links), np.random.default_rng(1)
    for _ in range(150):
        q, tool = random.uniform(-np.pi, np.pi, 6), tuple(random.uniform(-0.2, 0.2, 6))
        place, rotation = arm.flange(q)
        frame = denavit_hartenberg(links, q)
        assert np.allclose(frame[:3, 3], place, atol=1e-12)
        assert np.allclose(frame[:3, :3].ravel(), rotation, atol=1e-12)
        pose = arm.pose(q, tool)
        found = arm.inverse(pose, q, tool)
        assert found is not None
        again = arm.pose(found, tool)
        assert np.allclose(again[:3], pose[:3], atol=1e-8)
        assert angle_between(rotation_of(*again[3:]), rotation_of(*pose[3:])) < 1e-6
        assert np.abs(np.subtract(found, q)).max() < 1e-5, "another solution was nearer than the way there"
        moved = [
            np.subtract(arm.pose(q + 1e-6 * e, tool), arm.pose(q - 1e-6 * e, tool))[:3] for e in np.eye(6)
        ]
        assert np.allclose(np.array(moved).T / 2e-6, arm.jacobian(q, tool)[:3], atol=1e-6)


def test_every_solution_leads_to_the_pose_and_none_leads_beyond_reach() -> None:
    pose = ARM.pose(HOME + 0.1)
    solutions = ARM.solutions(pose, HOME)
    assert len({tuple(np.round(q, 6)) for q in solutions}) == 8
    for q in solutions:
        assert np.allclose(ARM.pose(q)[:3], pose[:3], atol=1e-9)
    assert ARM.inverse((3.0, 0.0, 0.0, 0.0, 0.0, 0.0), HOME) is None


def test_poses_turn_back() -> None:
    random = np.random.default_rng(2)
    for turn in [
        *random.uniform(-1.5, 1.5, (50, 3)),
        (np.pi, 0, 0),
        (0, np.pi, 0),
        (0, 0, -np.pi),
        (0, 0, 0),
    ]:
        rotation = rotation_of(*turn)
        assert angle_between(rotation_of(*vector_of(rotation)), rotation) < 1e-7
        pose = (0.1, -0.2, 0.3, *turn)
        assert np.allclose(pose_times(pose, inverse(pose)), 0.0, atol=1e-9)


def test_joint_moves_keep_speed_and_acceleration_and_arrive_together() -> None:
    end = HOME + np.array([0.5, -0.2, 0.1, 0.0, 0.3, -0.5])
    plans = run(JointMove(HOME, end, 0.8, 2.0))
    qd, qdd = np.array([p.qd for p in plans]), np.array([p.qdd for p in plans])
    assert np.array_equal(plans[-1].q, end)
    assert np.abs(qd).max() == pytest.approx(0.8)
    assert np.abs(qdd).max() == pytest.approx(2.0)
    assert len(plans) * 0.002 == pytest.approx(0.5 / 0.8 + 0.8 / 2.0, abs=0.004)
    shares = (np.array([p.q for p in plans]) - HOME)[:, [1, 2, 4]] / [-0.2, 0.1, 0.3]
    assert np.allclose(shares, shares[:, :1], atol=1e-9)


def test_lines_are_straight_and_singularities_are_refused() -> None:
    first = ARM.pose(HOME)
    end = (first[0], first[1] - 0.2, first[2] + 0.1, *first[3:])
    plans = run(LineMove(ARM, (0.0,) * 6, HOME, end, 0.25, 1.0))
    way = np.array([ARM.pose(p.q)[:3] for p in plans]) - first[:3]
    along = np.array([0.0, -0.2, 0.1]) / np.hypot(0.2, 0.1)
    assert np.abs(way - np.outer(way @ along, along)).max() < 1e-9
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / 0.002
    assert speed.max() == pytest.approx(0.25, rel=1e-3)
    with pytest.raises(MotionError, match=r"reach|singular|fast"):
        run(LineMove(ARM, (0.0,) * 6, HOME, (2.0, *first[1:]), 1.0, 5.0))


def test_the_servo_follows_as_documented() -> None:
    gain, lookahead, h = 600.0, 0.1, 0.002
    servo = Servo(Plan.resting(np.zeros(6)))
    lag = []
    for k in range(3000):
        target = 0.2 * k * h
        servo.set_target([target] * 6, lookahead, gain)
        lag.append(target - servo.advance(h).q[0])
    assert lag[-1] == pytest.approx(0.2 * lookahead, rel=0.05)
    jump = Servo(Plan.resting(np.zeros(6)))
    jump.set_target([3.0] * 6, 0.03, 2000.0)
    plans = [jump.advance(h) for _ in range(1500)]
    assert max(np.abs(p.qd).max() for p in plans) <= 3.15
    assert max(np.abs(p.qdd).max() for p in plans) <= 40.0 + 1e-9
    assert np.allclose(plans[-1].q, 3.0, atol=1e-6)


def lateness(values: np.ndarray, rates: np.ndarray, h: float) -> float:
    """How much later, in ticks, ``rates`` tell what ``values`` do: by least squares over a smooth stretch."""
    true = (values[2:] - values[:-2]) / (2.0 * h)
    change = (true[2:] - true[:-2]) / (2.0 * h)
    missing = (true - rates[1:-1])[1:-1]
    return float((missing * change).sum() / (change * change).sum() / h)


def servo_along_a_path(h: float) -> list[Plan]:
    servo = Servo(Plan.resting(HOME))
    plans = []
    for k in range(round(4.0 / h)):
        servo.set_target(HOME + 0.4 * np.sin(3.0 * k * h), 0.1, 300.0)
        plans.append(servo.advance(h))
    return plans[round(1.0 / h) :]


def line_while_it_speeds_up(h: float) -> list[Plan]:
    first = ARM.pose(HOME)
    move = LineMove(ARM, (0.0,) * 6, HOME, (first[0], first[1] - 0.3, *first[2:]), 1.0, 1.0)
    return [move.advance(h) for _ in range(round(0.5 / h))]


def tool_at_a_steady_speed(h: float) -> list[Plan]:
    speed = ToolSpeed(Plan.resting(HOME), ARM, (0.0,) * 6)
    speed.set_target([0.0, -0.3, 0.0, 0.0, 0.0, 0.0], 3.0)
    return [speed.advance(h) for _ in range(round(0.6 / h))][round(0.2 / h) :]


@pytest.mark.parametrize("h", [0.002, 0.008])
@pytest.mark.parametrize(
    "motion", [servo_along_a_path, line_while_it_speeds_up, tool_at_a_steady_speed], ids=lambda m: m.__name__
)
def test_angles_velocities_and_accelerations_belong_to_one_moment(motion, h) -> None:
    q, qd, qdd = (np.array(part) for part in zip(*motion(h), strict=True))
    assert abs(lateness(q, qd, h)) < 0.05
    assert abs(lateness(qd, qdd, h)) < 0.05


def test_speeds_and_stops() -> None:
    speed = JointSpeed(Plan.resting(HOME))
    speed.set_target([0.4, -0.2, 0, 0, 0, 0], 1.0)
    plan = [speed.advance(0.002) for _ in range(300)][-1]
    assert np.allclose(plan.qd, [0.4, -0.2, 0, 0, 0, 0])
    plans = run(Halt.of_joints(plan, 2.0))
    assert len(plans) * 0.002 == pytest.approx(0.2, abs=0.005)
    assert np.allclose(plans[-1].q - plan.q, 0.5 * 0.2 * plan.qd, atol=1e-12)
    tool = ToolSpeed(Plan.resting(HOME), ARM, (0.0,) * 6)
    tool.set_target([0.0, 0.0, 0.1, 0.0, 0.0, 0.0], 0.5)
    plan = [tool.advance(0.002) for _ in range(300)][-1]
    assert np.allclose(ARM.jacobian(plan.q) @ plan.qd, [0, 0, 0.1, 0, 0, 0], atol=1e-4)
    assert len(run(Halt.of_tool(plan, 1.0, ARM, (0.0,) * 6))) * 0.002 == pytest.approx(0.1, abs=0.005)


def test_a_path_blends_without_a_stop_or_a_jump() -> None:
    corner, end = HOME + np.array([0.5, 0, 0, 0, 0, 0]), HOME + np.array([0.5, 0.3, 0, 0, 0, 0])
    told: list[int] = []
    moves = [
        (lambda q: JointMove(q, corner, 1.0, 3.0), corner, 0.05),
        (lambda q: JointMove(q, end, 1.0, 3.0), end, 0.0),
    ]
    plans = run(Path(ARM, HOME, moves, told.append))
    assert told == [0, 1]
    assert np.allclose(plans[-1].q, end)
    q = np.array([p.q for p in plans])
    assert np.abs(np.diff(q, axis=0)).max() < 2 * 0.002 * 1.0
    assert np.abs(np.diff(q, n=2, axis=0)).max() / 0.002**2 < 2 * 3.0 + 1e-6
    moving = np.abs(np.array([p.qd for p in plans])).max(axis=1)
    assert moving[100:-100].min() > 0.1, "it stopped at the corner"
