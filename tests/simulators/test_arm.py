"""An arm of somebody's own file: what its joints carry and rub, put back into the file."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import labhil as lh
from labhil.analysis.patch import MAX_ERROR_RATIO
from labhil.errors import RecordingError, RigFileError, UsageError
from labhil.physics.arm.rigid_body import PER_LINK, gravity_in_base
from labhil.physics.arm.tree import Tree
from labhil.simulators.arm import ArmSimulator, arm_simulator
from labhil.simulators.inertia import centroidal, is_body, nearest_bodies

sys.path.insert(0, str(Path(__file__).parent))
from arm_file import DAMPING, DRY, LOAD_SHARE, MJCF, ROTOR, URDF, bench, recorded, torques, truth

BRANCHED = """<mujoco model="branched">
  <compiler angle="radian"/>
  <option gravity="3 -4 -8.4439"/>
  <worldbody>
    <body name="a" pos="0.1 0 0.2" quat="1 0.3 -0.2 0.1">
      <joint name="j0" axis="1 2 -1" pos="0.02 0.03 -0.01" ref="0.4"/>
      <inertial mass="2" pos="0.1 0.05 0" quat="1 0.2 0 0.4" diaginertia="0.02 0.03 0.04"/>
      <body name="fixed" pos="0.1 0.2 0.3" euler="0.2 0.3 0.4">
        <geom type="box" size="0.1 0.05 0.02"/>
        <body name="b" pos="0.2 0 0.1" euler="0.5 -0.2 0.3">
          <joint name="j1" axis="0 1 0.5" pos="0 0.1 0"/>
          <geom type="capsule" fromto="0 0 0 0.3 0.1 0" size="0.03"/>
        </body>
      </body>
      <body name="c" pos="-0.2 0 0.1">
        <joint name="j2" axis="0 0 1"/>
        <geom type="sphere" size="0.08" pos="0.1 0 0"/>
        <body name="d" pos="0.3 0 0">
          <joint name="j3" axis="1 0 0" ref="-0.7"/>
          <geom type="sphere" size="0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def tree_of(folder: Path, text: str) -> tuple[Tree, mujoco.MjModel]:
    path = folder / "arm.xml"
    path.write_text(text, encoding="utf-8")
    return arm_simulator(path).arm.tree, mujoco.MjModel.from_xml_path(str(path))


MESHED = URDF.replace(
    "<inertial>",
    """<visual><geometry><mesh filename="package://reach/meshes/link.dae"/></geometry></visual>
    <collision><geometry><mesh filename="package://reach/meshes/link.stl"/></geometry></collision>
    <inertial>""",
)
"""As programs of ROS write it: where the meshes are, only ROS knows."""


def test_an_arm_needs_no_meshes_where_its_links_have_inertias(tmp_path: Path) -> None:
    arms = {}
    for name, text in (("meshed", MESHED), ("bare", URDF)):
        path = tmp_path / f"{name}.urdf"
        path.write_text(text, encoding="utf-8")
        arms[name] = arm_simulator(path).arm
    for field in ("body_mass", "body_inertia", "body_ipos", "jnt_axis"):
        meshed, bare = (getattr(arms[name].model, field) for name in ("meshed", "bare"))
        np.testing.assert_allclose(meshed, bare)


@pytest.mark.parametrize(
    "text",
    [
        MESHED.replace("<inertial>", "<!--", 1).replace("</inertial>", "-->", 1),
        MESHED.replace('type="revolute"', 'type="fixed"', 2).replace('type="continuous"', 'type="fixed"', 2),
    ],
    ids=["a mesh that gives a link its inertia", "a mechanism of one joint, which may touch something"],
)
def test_meshes_that_matter_are_asked_for(tmp_path: Path, text: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=r"found: .*meshes/link"):
        lh.mujoco_simulator(path)


@pytest.mark.extended
def test_torques_are_those_of_mujoco_for_any_arrangement_of_hinges(tmp_path: Path) -> None:
    tree, model = tree_of(tmp_path, BRANCHED)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.gravity *= 9.81 / np.linalg.norm(model.opt.gravity)
    motion = np.random.default_rng(3).normal(size=(3, 40, 4))
    itself = torques(model, *motion)
    np.testing.assert_allclose(tree.torques(*motion, gravity_in_base(), tree.begin), itself, atol=1e-9)
    np.testing.assert_allclose(tree.regressor(*motion, gravity_in_base()) @ tree.begin, itself, atol=1e-9)
    assert list(tree.carrier) == [-1, 0, 0, 2]
    assert [list(tree.loaded(link)) for link in range(4)] == [[0], [0, 1], [0, 2], [0, 2, 3]]


@pytest.mark.extended
def test_the_file_says_what_is_measured_and_what_a_diagnosis_begins_with(tmp_path: Path) -> None:
    rig = lh.model(bench(tmp_path))
    assert {"payload", "base_tilt", "load_dependent_friction"} <= {term.name for term in rig.terms.values()}
    arm = lh.mujoco_simulator(tmp_path / "reach.xml")
    assert isinstance(arm, ArmSimulator)
    assert (arm.joints, arm.output, arm.unit) == (("turn", "lift", "bend"), "actual_current", "A")
    assert arm.initial_terms == ("viscous_friction", "coulomb_friction", "added_inertia", "sensor_offset")
    assert arm.arm.nominal["viscous_friction.coefficient[0]"] == 1.0
    assert [signal.width for signal in arm.kind.inputs] == [3, 3]


@pytest.mark.extended
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (MJCF.replace("<worldbody>", '<option gravity="0 0 0"/><worldbody>'), "expected gravity of 9.81"),
        (MJCF.replace('<body name="upper"', '<body name="upper" gravcomp="1"'), "expected no gravcomp"),
        (MJCF.replace('name="lift"', 'name="lift" stiffness="5"'), "found other forces on lift: springs"),
        (MJCF.replace('name="lift"', 'name="lift" type="slide"'), "of which lift are no hinges"),
        (
            MJCF.replace('<joint name="lift"', '<joint name="x" axis="1 0 0"/><joint name="lift"'),
            "one joint for each body",
        ),
        ("<robot", "expected a file that MuJoCo loads"),
    ],
)
def test_what_an_arm_cannot_be_is_named(tmp_path: Path, text: str, expected: str) -> None:
    rig = bench(tmp_path, text)
    with pytest.raises(RigFileError, match=expected):
        lh.model(rig)


@pytest.mark.extended
def test_inputs_and_outputs_of_an_arm_are_its_motion_and_its_drives(tmp_path: Path) -> None:
    bench(tmp_path)
    with pytest.raises(UsageError, match=r"actual_q and actual_qd with 3 columns each \(turn, lift, bend\)"):
        lh.mujoco_simulator(tmp_path / "reach.xml", inputs={"torque": "turn"})
    with pytest.raises(UsageError, match='joint_torque = "torque"'):
        lh.mujoco_simulator(tmp_path / "reach.xml", outputs={"angle": "bend"})


@pytest.mark.extended
def test_a_recording_of_something_else_is_told_what_an_arm_needs(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    t = np.arange(0.0, 2.0, 0.01)
    plain = lh.recording(t, {"voltage": np.sin(t)}, {"speed": np.cos(t)}, rig="dc_motor")
    plain.save(tmp_path / "motor.mcap")
    with pytest.raises(RecordingError) as refused:
        lh.fit(tmp_path / "motor.mcap", rig)
    assert "expected the signals actual_q, actual_qd, joint_torque with 3 columns each" in str(refused.value)
    assert "(turn, lift, bend) for reach.xml, found voltage, speed." in str(refused.value)
    assert "actual_q = { columns = […, …, …] }" in str(refused.value)


@pytest.mark.extended
def test_a_fit_finds_friction_rotors_and_a_heavier_link(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    fit = lh.fit(recorded(tmp_path, rig, heavier=1.2), rig)
    found = {(p.name, p.joint): p.value for p in fit.parameters}
    for joint in range(3):
        assert found["viscous_friction.coefficient", joint] == pytest.approx(DAMPING[joint], rel=0.02)
        assert found["coulomb_friction.level", joint] == pytest.approx(DRY[joint], rel=0.03)
    assert found["load_dependent_friction.coefficient", 1] == pytest.approx(LOAD_SHARE, rel=0.03)
    # the others act just as the inertia of links and carry its change
    assert found["added_inertia.inertia", 2] == pytest.approx(ROTOR[2], rel=0.03)
    # 0.36 kg·m: 20 % more of the 1.5 kg at 0.14 m from the joint's axis, with the tool at 0.29 m
    assert found["grouped_first_moment_x", 2] == pytest.approx(1.2 * 1.5 * 0.14 + 0.4 * 0.29, rel=0.01)


@pytest.mark.extended
def test_a_joint_that_turns_the_other_way_is_said_so(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    run = recorded(tmp_path, rig, signs=(1.0, -1.0, 1.0), seconds=20.0)
    notes = lh.fit(run, rig, terms=["viscous_friction", "sensor_offset"]).to_dict()["notes"]
    assert [note[:14] for note in notes if "turns the other way" in note] == ["lift (joint 1)"]


@pytest.mark.extended
@pytest.mark.parametrize(("text", "name"), [(MJCF, "reach.xml"), (URDF, "reach.urdf")])
def test_a_diagnosis_is_put_into_the_file_and_mujoco_keeps_its_promise(
    tmp_path: Path, text: str, name: str
) -> None:
    rig = bench(tmp_path, text, name)
    found = lh.diagnose(recorded(tmp_path, rig, text, heavier=1.2), rig)
    assert {(m.term, m.joint) for m in found.missing} == {("load_dependent_friction", 1)}
    changed = {(c.name, c.joint) for c in found.changed}
    assert ("grouped_first_moment_x", 2) in changed
    assert ("viscous_friction.coefficient", 0) in changed
    out = tmp_path / f"fixed_{name}"
    fixed = found.patch(tmp_path / name, out, rig=rig)
    assert (tmp_path / name).read_text(encoding="utf-8") == text
    assert fixed.attempts[-1].ratio < MAX_ERROR_RATIO
    assert all(joint.after < 0.02 * joint.before for joint in fixed.joints)
    repaired = mujoco.MjModel.from_xml_path(str(out))
    np.testing.assert_allclose(repaired.dof_damping, DAMPING, rtol=0.02)
    np.testing.assert_allclose(repaired.dof_frictionloss, DRY, rtol=0.03)
    real, file = truth(tmp_path, text, heavier=1.2), truth(tmp_path, text)
    last = int(real.jnt_bodyid[2])
    more = float(real.body_mass[last] - file.body_mass[last])
    assert repaired.body_mass[last] - file.body_mass[last] == pytest.approx(more, rel=0.3)
    assert fixed.companion is not None
    written = fixed.companion.read_text(encoding="utf-8")
    assert "load_dependent_friction of lift: tau = mu |tau_load| sgn qd" in written
    # URDF has no rotors
    assert ("model.dof_armature[:] += ARMATURE" in written) == (name.endswith("urdf"))
    assert "labhil." not in written
    assert json.dumps(fixed.to_dict())
    with pytest.raises(UsageError, match="nothing is overwritten"):
        found.patch(tmp_path / name, out, rig=rig)


@pytest.mark.extended
def test_values_of_another_file_are_refused(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    found = lh.fit(recorded(tmp_path, rig, seconds=20.0), rig)
    other = tmp_path / "other.xml"
    other.write_text(MJCF.replace('mass="4"', 'mass="9"'), encoding="utf-8")
    with pytest.raises(UsageError, match="was it made with another file"):
        found.patch(other, tmp_path / "fixed.xml", rig=rig)
    assert not (tmp_path / "fixed.xml").exists()


def test_bodies_are_found_that_load_the_joints_as_wanted(tmp_path: Path) -> None:
    """Wanted: a lighter forearm."""
    tree, _ = tree_of(tmp_path, MJCF)
    lighter = tree.begin.copy()
    lighter[-PER_LINK:] *= 0.6
    motion = np.random.default_rng(5).normal(size=(3, 50, 3))
    wanted = tree.torques(*motion, gravity_in_base(), lighter)
    armature = np.array([0.4, 0.5, 0.2])
    own = np.zeros_like(tree.begin)
    found = nearest_bodies(tree, tree.begin, lighter, own, armature)
    links = found.inertial.reshape(3, PER_LINK)
    assert all(is_body(link) for link in links)
    loads = tree.torques(*motion, gravity_in_base(), found.inertial) + motion[2] * (found.armature - armature)
    assert np.max(np.abs(loads - wanted)) < 1e-3 * np.max(np.abs(wanted))
    mass, centre, _ = centroidal(links[2])
    assert mass < 1.7
    assert 0.1 < centre[0] < 0.25


def test_what_needs_no_change_is_left_alone(tmp_path: Path) -> None:
    tree, _ = tree_of(tmp_path, MJCF)
    rotors = np.array([0.4, 0.5, 0.2])
    found = nearest_bodies(tree, tree.begin, tree.begin, np.zeros_like(tree.begin), rotors)
    assert np.array_equal(found.inertial, tree.begin)
    assert np.array_equal(found.armature, rotors)
