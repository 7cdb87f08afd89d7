"""The arm's rigid body as it is fitted: against MuJoCo, which shares no code with it, and closed forms."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path

import mujoco
import numpy as np
import pytest

from labhil.errors import RigFileError
from labhil.physics.arm.grouped import group_parameters
from labhil.physics.arm.links import PER_LINK, UR5, inertial_of, load_links
from labhil.physics.arm.rigid_body import GRAVITY, gravity_in_base, regressor

LENGTHS = [
    (0.089159, 0.0, pi / 2),
    (0.0, -0.425, 0.0),
    (0.0, -0.39225, 0.0),
    (0.10915, 0.0, pi / 2),
    (0.09465, 0.0, -pi / 2),
    (0.0823, 0.0, 0.0),
]
MASSES = [3.7, 8.393, 2.33, 1.219, 1.219, 0.1879]
CENTRES = [
    (0.0, -0.02561, 0.00193),
    (0.2125, 0.0, 0.11336),
    (0.15, 0.0, 0.0265),
    (0.0, -0.0018, 0.01634),
    (0.0, 0.0018, 0.01634),
    (0.0, 0.0, -0.001159),
]
# products of inertia that the reference text's arm does not have: here they must count too
INERTIAS = [
    (0.0085, 0.0064, 0.0085, 0.001, -0.0005, 0.0007),
    (0.0085, 0.212, 0.212, 0.003, 0.002, -0.001),
    (0.0017, 0.0473, 0.0473, 0.0004, -0.0003, 0.0002),
    (0.0018, 0.0018, 0.0014, 0.0001, 0.0002, -0.0001),
    (0.0018, 0.0018, 0.0014, 0.0002, -0.0001, 0.0001),
    (0.0008, 0.0008, 0.0013, 0.00001, 0.00002, 0.00003),
]


def motions(n=60, seed=0):
    random = np.random.default_rng(seed)
    return (
        random.uniform(-pi, pi, (n, 6)),
        random.normal(size=(n, 6)),
        3.0 * random.normal(size=(n, 6)),
    )


def mujoco_torques(masses, centres, inertias, gravity, motion):
    """Inverse dynamics by an engine that is given bodies, hinges and gravity, and no regressor."""
    inner = ""
    rows = list(zip(LENGTHS, masses, centres, inertias, strict=True))
    for (d, a, alpha), mass, centre, inertia in reversed(rows):
        c, s = cos(alpha), sin(alpha)
        inner = (
            f'<body pos="{a} 0 {d}" quat="{cos(alpha / 2)!r} {sin(alpha / 2)!r} 0 0">'
            f'<joint type="hinge" axis="0 {s!r} {c!r}" pos="{-a} {-d * s!r} {-d * c!r}"/>'
            f'<inertial pos="{centre[0]} {centre[1]} {centre[2]}" mass="{mass}"'
            f' fullinertia="{" ".join(map(str, inertia))}"/>{inner}</body>'
        )
    g = " ".join(repr(float(x)) for x in gravity)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="{g}"/><worldbody>{inner}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    out = np.empty_like(motion[0])
    for i, (q, qd, qdd) in enumerate(zip(*motion, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
    return out


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.3, -0.7)], ids=["upright", "tilted"])
def test_torques_are_mujocos(tilt):
    inertial = np.concatenate([inertial_of(*row) for row in zip(MASSES, CENTRES, INERTIAS, strict=True)])
    motion, gravity = motions(), gravity_in_base(*tilt)
    expected = mujoco_torques(MASSES, CENTRES, INERTIAS, gravity, motion)
    np.testing.assert_allclose(regressor(UR5, *motion, gravity) @ inertial, expected, atol=1e-9)


def test_the_default_is_the_manufacturers_ur5():
    plain = [(*inertia[:3], 0.0, 0.0, 0.0) for inertia in INERTIAS]
    plain[5] = (0.00008, 0.00008, 0.00013, 0.0, 0.0, 0.0)
    motion = motions(20, seed=1)
    expected = mujoco_torques(MASSES, CENTRES, plain, gravity_in_base(), motion)
    np.testing.assert_allclose(regressor(UR5, *motion, gravity_in_base()) @ UR5.inertial, expected, atol=1e-9)


def test_each_column_is_the_torque_of_one_parameter():
    """Of the forearm's inertia only, at rest and turning about the base: closed forms."""
    still = np.zeros((1, 6))
    y = regressor(UR5, still, still, still, gravity_in_base())[0]
    mass_of_forearm, moment_of_forearm = 2 * PER_LINK, 2 * PER_LINK + 1
    # the arm lies flat along −x: a mass at the forearm's end hangs 0.81725 m out
    assert y[1, mass_of_forearm] == pytest.approx(GRAVITY * -(0.425 + 0.39225), abs=1e-12)
    assert y[2, mass_of_forearm] == pytest.approx(GRAVITY * -0.39225, abs=1e-12)
    assert y[1, moment_of_forearm] == pytest.approx(GRAVITY, abs=1e-12)
    np.testing.assert_allclose(y[0], 0.0, atol=1e-12)
    turning = np.array([[2.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    spun = regressor(UR5, still, still, turning, np.zeros(3))[0]
    assert spun[0, mass_of_forearm] == pytest.approx(2.0 * (0.425 + 0.39225) ** 2, abs=1e-12)
    assert spun[0, 2 * PER_LINK + 5] == pytest.approx(2.0, abs=1e-12)


def test_gravity_of_a_tilted_base_keeps_its_size():
    for roll, pitch in [(0.0, 0.0), (0.2, 0.0), (0.0, -0.4), (1.0, 0.5)]:
        assert np.linalg.norm(gravity_in_base(roll, pitch)) == pytest.approx(GRAVITY)
    np.testing.assert_allclose(gravity_in_base(), [0.0, 0.0, -GRAVITY])


def test_thirty_six_grouped_parameters_do_what_sixty_do():
    group = group_parameters(replace(UR5, inertial=None))
    assert len(group.kept) == 36
    motion = motions(200, seed=5)
    y = regressor(UR5, *motion, gravity_in_base()).reshape(-1, 60)
    values = np.linalg.lstsq(y[:, list(group.kept)], y @ UR5.inertial, rcond=None)[0]
    np.testing.assert_allclose(y @ group.embed(values), y @ UR5.inertial, atol=1e-8)
    # and the words say of each which of the sixty it stands for
    place = [name for name, _, _ in group.names()].index("grouped_first_moment_x")
    assert group.combinations[place].startswith("mx_1 ")
    assert "0.425·m_5" in group.combinations[place]


LINK = "[[joint]]\nd = 0.1\na = 0.2\nalpha = 0.0\n"
INERTIA = "mass = 1.0\ncentre = [0.0, 0.0, 0.1]\ninertia = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]\n"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (LINK * 5, "expected 6 tables"),
        (LINK * 5 + LINK + INERTIA, "joints 0, 1, 2, 3, 4"),
        (LINK * 5 + LINK + "mass = 1.0\n", "centre and inertia missing"),
        (LINK * 5 + LINK.replace("alpha", "alfa"), "did you mean 'alpha'"),
        (LINK * 5 + LINK.replace("0.2", "nan"), "finite"),
        (LINK * 5 + LINK + INERTIA.replace("1.0\n", "-1.0\n"), "greater than 0"),
        ("[[joint]\n", "not TOML"),
    ],
)
def test_a_wrong_table_of_links_is_refused_in_words(tmp_path: Path, text, told):
    path = tmp_path / "links.toml"
    path.write_text(text)
    with pytest.raises(RigFileError, match=r"links\.toml") as refused:
        load_links(path)
    assert told in str(refused.value)


def test_a_table_of_links_without_masses_is_lengths_only(tmp_path: Path):
    path = tmp_path / "links.toml"
    path.write_text(LINK * 6)
    links = load_links(path)
    assert links.inertial is None
    np.testing.assert_array_equal(links.a, [0.2] * 6)
    path.write_text((LINK + INERTIA) * 6)
    inertial = load_links(path).inertial
    assert inertial is not None
    np.testing.assert_allclose(inertial[:PER_LINK], [1.0, 0, 0, 0.1, 0.11, 0.11, 0.1, 0, 0, 0])
