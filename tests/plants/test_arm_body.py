"""The rigid body of the simulated arm against mechanics written down here, and nothing of MuJoCo's."""

import subprocess
import sys

import numpy as np
import pytest

from labhil.errors import MissingExtraError, UsageError
from labhil.plants.arm import ARMS, UR5, ArmPlant, Links
from labhil.plants.arm.rigid_body import Load, RigidBody

G = 9.81
STILL = np.zeros((1, 6))


def frames(links: Links, q: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Rotations and origins of frames 0 to 6 in the base, by the standard Denavit-Hartenberg matrix."""
    pose = np.eye(4)
    rotations, origins = [pose[:3, :3]], [pose[:3, 3]]
    for link, angle in zip(links.links, q, strict=True):
        ca, sa, c, s = np.cos(link.alpha), np.sin(link.alpha), np.cos(angle), np.sin(angle)
        pose = pose @ np.array(
            [
                [c, -s * ca, s * sa, link.a * c],
                [s, c * ca, -c * sa, link.a * s],
                [0.0, sa, ca, link.d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        rotations.append(pose[:3, :3])
        origins.append(pose[:3, 3])
    return rotations, origins


def tensor(link) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = link.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def newton_euler(links: Links, q, qd, qdd, gravity=(0.0, 0.0, -G), payload=(0.0, (0.0, 0.0, 0.0))):
    """Joint torques by Newton's and Euler's laws, from link to link outwards, all in the base's frame."""
    rotations, origins = frames(links, q)
    omega, alpha, acceleration = np.zeros(3), np.zeros(3), -np.array(gravity)
    wrenches = []
    for i, link in enumerate(links.links):
        axis, rotation = rotations[i][:, 2], rotations[i + 1]
        alpha = alpha + axis * qdd[i] + np.cross(omega, axis * qd[i])
        omega = omega + axis * qd[i]
        reach = origins[i + 1] - origins[i]
        acceleration = acceleration + np.cross(alpha, reach) + np.cross(omega, np.cross(omega, reach))
        inertia = rotation @ tensor(link) @ rotation.T
        parts = [(link.mass, rotation @ link.centre, inertia)]
        if i == 5 and payload[0]:
            parts.append((payload[0], rotation @ payload[1], np.zeros((3, 3))))
        for mass, arm, about_centre in parts:
            of_centre = acceleration + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
            force = mass * of_centre
            couple = about_centre @ alpha + np.cross(omega, about_centre @ omega)
            wrenches.append((i, force, couple, origins[i + 1] + arm))
    torques = np.zeros(6)
    for joint in range(6):
        carried = [wrench for wrench in wrenches if wrench[0] >= joint]
        moment = sum(couple + np.cross(at - origins[joint], force) for _, force, couple, at in carried)
        torques[joint] = rotations[joint][:, 2] @ moment
    return torques


def mass_matrix(links: Links, q: np.ndarray) -> np.ndarray:
    """Equation 4.53 with the Jacobians of the centres of mass."""
    rotations, origins = frames(links, q)
    matrix = np.zeros((6, 6))
    for i, link in enumerate(links.links):
        centre = origins[i + 1] + rotations[i + 1] @ link.centre
        turning, moving = np.zeros((3, 6)), np.zeros((3, 6))
        for j in range(i + 1):
            turning[:, j] = rotations[j][:, 2]
            moving[:, j] = np.cross(turning[:, j], centre - origins[j])
        inertia = rotations[i + 1] @ tensor(link) @ rotations[i + 1].T
        matrix += link.mass * moving.T @ moving + turning.T @ inertia @ turning
    return matrix


def masses_by_torques(body: RigidBody, q: np.ndarray) -> np.ndarray:
    rest = body.torques(q[None], STILL, STILL)[0]
    columns = body.torques(np.tile(q, (6, 1)), np.zeros((6, 6)), np.eye(6)) - rest
    return columns.T


@pytest.mark.parametrize("name", ARMS)
def test_inverse_dynamics_is_newton_and_eulers(name):
    random = np.random.default_rng(1)
    q, qd, qdd = random.uniform(-3.0, 3.0, (3, 20, 6))
    expected = [newton_euler(ARMS[name], *row) for row in zip(q, qd, qdd, strict=True)]
    torques = RigidBody(ARMS[name]).torques(q, qd, qdd)
    np.testing.assert_allclose(torques, expected, rtol=1e-9, atol=1e-9)


def test_gravity_of_the_stretched_arm_is_weights_times_distances():
    """All links lie along −x; seen from above, joints 1 and 2 carry everything beyond them."""
    torques = RigidBody(UR5).torques(STILL, STILL, STILL)[0]
    at = np.array([0.0, -0.2125, -0.425 - 0.39225 + 0.15, -0.81725, -0.81725, -0.81725])
    weights = G * np.array([link.mass for link in UR5.links])
    expected = [0.0, weights[1:] @ at[1:], weights[2:] @ (at[2:] + 0.425), 0.0, 0.0, 0.0]
    np.testing.assert_allclose(torques, expected, atol=1e-9)


def test_gravity_of_the_upright_arm_is_that_of_its_wrist():
    """Links 2 and 3 stand above joint 1; what lies beyond them leans out by its offsets."""
    upright = np.array([[0.7, -np.pi / 2, 0.0, 0.0, 0.0, 0.0]])
    torques = RigidBody(UR5).torques(upright, STILL, STILL)[0]
    leaning = G * (1.219 * 0.01634 + 1.219 * (0.09465 - 0.0018) + 0.1879 * 0.09465)
    beside = G * (1.219 * 0.01634 + 0.1879 * (0.0823 - 0.001159))
    np.testing.assert_allclose(np.abs(torques), [0.0, leaning, leaning, leaning, beside, 0.0], atol=1e-9)


def test_the_mass_matrix_is_that_of_the_jacobians():
    body, random = RigidBody(UR5), np.random.default_rng(2)
    for q in random.uniform(-3.0, 3.0, (5, 6)):
        by_torques = masses_by_torques(body, q)
        np.testing.assert_allclose(by_torques, mass_matrix(UR5, q), atol=1e-9)
        np.testing.assert_allclose(by_torques, by_torques.T, atol=1e-9)


def test_power_less_gravitys_is_the_growth_of_kinetic_energy():
    """q̇ᵀ·(τ − G) = d/dt ½·q̇ᵀ·M·q̇: what Coriolis and centrifugal torques have to be."""
    body, random = RigidBody(UR5), np.random.default_rng(3)
    centre, swing, frequency = random.uniform(-1.0, 1.0, (3, 6))

    def motion(t):
        phase = (2.0 + frequency) * t
        w = 2.0 + frequency
        return centre + swing * np.sin(phase), w * swing * np.cos(phase), -(w**2) * swing * np.sin(phase)

    def energy(t):
        q, qd, _ = motion(t)
        return 0.5 * qd @ mass_matrix(UR5, q) @ qd

    for t in (0.3, 0.9, 2.0):
        q, qd, qdd = motion(t)
        torque = body.torques(q[None], qd[None], qdd[None])[0] - body.torques(q[None], STILL, STILL)[0]
        growth = (energy(t + 1e-5) - energy(t - 1e-5)) / 2e-5
        assert qd @ torque == pytest.approx(growth, rel=1e-6, abs=1e-7)


def test_a_payload_adds_what_a_point_mass_must():
    random = np.random.default_rng(4)
    q, qd, qdd = random.uniform(-2.0, 2.0, (3, 10, 6))
    centre = (0.03, -0.02, 0.09)
    torques = RigidBody(UR5, Load(mass=2.805, centre=centre)).torques(q, qd, qdd)
    payload = (2.805, np.array(centre))
    expected = [newton_euler(UR5, *row, payload=payload) for row in zip(q, qd, qdd, strict=True)]
    np.testing.assert_allclose(torques, expected, rtol=1e-9, atol=1e-9)


def test_a_tilted_base_turns_gravity():
    roll, pitch = 0.2, -0.3
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    gravity = (about_y @ about_x).T @ [0.0, 0.0, -G]
    q = np.array([0.4, -1.0, 1.2, 0.3, 0.8, 0.0])
    torques = RigidBody(UR5, Load(roll=roll, pitch=pitch)).torques(q[None], STILL, STILL)[0]
    still = np.zeros(6)
    np.testing.assert_allclose(torques, newton_euler(UR5, q, still, still, gravity), atol=1e-9)
    assert abs(torques[0]) > 0.5


def test_the_cable_pulls_on_the_wrist_alone_and_only_when_taut():
    q = np.random.default_rng(5).uniform(-3.0, 3.0, (200, 6))
    rest = np.zeros_like(q)
    with_cable = RigidBody(UR5, Load(cable_stiffness=150.0, cable_length=0.16)).torques(q, rest, rest)
    pull = with_cable - RigidBody(UR5).torques(q, rest, rest)
    np.testing.assert_allclose(pull[:, :3], 0.0, atol=1e-9)
    slack = np.all(np.abs(pull) < 1e-12, axis=1)
    assert 0.02 < slack.mean() < 0.98
    assert 0.2 < np.abs(pull[:, 3:]).max() < 10.0


def test_without_the_engine_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'labhil\[arm\]'"):
        ArmPlant()


def test_the_engine_is_loaded_by_the_first_arm_only(tmp_path):
    code = "import labhil.plants.arm, sys; print('mujoco' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_links_that_make_no_arm_are_refused():
    with pytest.raises(UsageError, match="expected 6 links, found 5"):
        Links("stump", UR5.links[:5])
