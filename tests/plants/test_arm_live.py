"""The arm that keeps pace with a clock is the same world as the one with a physics engine."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.errors import UsageError
from labhil.plants.arm import UR3E, UR5, UR10E, ArmPlant, LiveArm, Setpoint
from labhil.plants.arm.newton_euler import RecursiveBody
from labhil.plants.arm.rigid_body import Load, RigidBody

QUIET = dict.fromkeys(
    ("q_noise", "qd_noise", "current_noise", "current_resolution", "temperature_noise", "voltage_noise"), 0.0
)
RUBBING = ("viscous_friction", "coulomb_friction", "stribeck_friction", "torque_ripple", "added_inertia")


@pytest.mark.parametrize("links", [UR5, UR10E, UR3E], ids=lambda links: links.name)
def test_recursion_and_engine_agree(links) -> None:
    load = Load(1.3, (0.02, -0.03, 0.08), 0.02, 0.03)
    q, qd, qdd = np.random.default_rng(1).uniform(-3.0, 3.0, (3, 40, 6))
    engine, recursion = RigidBody(links, load), RecursiveBody(links, load)
    assert np.allclose(engine.torques(q, qd, qdd), recursion.torques(q, qd, qdd), atol=1e-10)
    armature = np.linspace(0.1, 0.6, 6)
    engine.set_armature(armature)
    recursion.set_armature(armature)
    for i in range(5):
        assert np.allclose(
            engine.accelerations(q[i], qd[i], 10 * qdd[i]),
            recursion.accelerations(q[i], qd[i], 10 * qdd[i]),
            atol=1e-8,
        )


@pytest.mark.parametrize("extra", [(), ("clock_offset",), ("joint_elasticity",), ("payload",)])
def test_tick_by_tick_it_is_the_same_arm(extra: tuple[str, ...]) -> None:
    planned = ArmPlant(QUIET, RUBBING + extra, 3, 0.008)
    live = LiveArm(QUIET, RUBBING + extra, 3)
    home = np.array([0.0, -1.5, 1.0, -1.0, -1.5, 0.0])
    planned.place(home)
    live.place(home)
    rate = 2.0 * np.pi
    for k in range(1, 120):
        phase = rate * 0.008 * k
        motion = (
            home + 0.3 * (1.0 - np.cos(phase)),
            0.3 * rate * np.sin(phase) * np.ones(6),
            0.3 * rate**2 * np.cos(phase) * np.ones(6),
        )
        there, here = planned.step(*motion, 0.008), live.step(Setpoint(*motion), 0.008)
        assert np.allclose(there.actual_q[0], here.q, atol=1e-12)
        if k > 20:  # friction at rest begins with what was left of an earlier motion
            assert np.allclose(there.actual_current[0], here.current, atol=1e-9)
            assert np.allclose(there.target_moment[0], here.target_moment, atol=1e-9)
            assert np.allclose(there.joint_temperatures[0], here.temperature, atol=0.07)


def test_what_the_controller_believes_is_not_what_the_flange_carries() -> None:
    arm = LiveArm(QUIET | {"payload.mass": 2.0}, ("payload",))
    home, still = np.array([0.0, -1.0, 1.0, -1.5, -1.5, 0.0]), np.zeros(6)
    arm.place(home)
    unaware = arm.step(Setpoint(home, still, still), 0.002)
    missing = unaware.current * arm.torque_constant - unaware.target_moment
    assert abs(missing[1]) > 5.0
    arm.set_expected_load(2.0, (0.0, 0.0, 0.08), (0.0, 0.0, -9.81))
    aware = arm.step(Setpoint(home, still, still), 0.002)
    assert np.allclose(aware.current * arm.torque_constant, aware.target_moment, atol=1e-9)


def test_a_cable_needs_the_engine() -> None:
    with pytest.raises(UsageError, match="hidden_cable"):
        LiveArm({}, ("hidden_cable",))
