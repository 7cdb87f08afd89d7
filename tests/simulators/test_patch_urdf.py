"""A repaired URDF with one joint that moves: what it can hold, and what stands beside it."""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import labhil as lh
from labhil.analysis.patch import MAX_ERROR_RATIO
from labhil.simulators.companion import Usage, companion_text, sort_effects
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.urdf_patches import patch_urdf, shorten_urdf_step
from labhil.simulators.xml_text import XmlText

sys.path.insert(0, str(Path(__file__).parent))
from pendulum_plant import DRAG, GRAVITY, INERTIA, swung, torques

FILE = """<?xml version="1.0"?>
<!-- all values from the drawing -->
<robot name="rod">
  <link name="stand"/>
  <link name="rod">
    <inertial>
      <origin xyz="0 0 -0.1" rpy="0 0 0"/>
      <mass value="0.3"/>
      <inertia ixx="0.0113" ixy="0" ixz="0" iyy="0.0113" iyz="0" izz="1e-3"/>
    </inertial>
  </link>
  <link name="bob">
    <inertial><mass value="0.1"/>
      <inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>
  </link>
  <joint name="hinge" type="continuous">
    <parent link="stand"/>
    <child link="rod"/>
    <axis xyz="0 1 0"/>
  </joint>
  <joint name="screw" type="fixed"><parent link="rod"/><child link="bob"/><origin xyz="0 0 -0.1"/></joint>
</robot>
"""
RIG = """[model]
mujoco = "rod.urdf"
inputs = { torque = "hinge" }
outputs = { angle = "hinge" }
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    (tmp_path / "rod.urdf").write_text(FILE, encoding="utf-8")
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    return tmp_path / "rig.toml"


def test_friction_that_falls_with_warmth_is_given_what_falls(rig: Path) -> None:
    """The file holds the viscous friction, and its companion what warmth takes from it."""
    path = rig.with_name("rod.urdf")
    described, text = read_mechanism(path, {"torque": "hinge"}), XmlText.read(path)
    values = {"viscous_friction.coefficient": 0.02, "temperature_dependent_friction.rate": 0.03}
    found = patch_urdf(described, text, values)
    assert found.remaining["temperature_dependent_friction.coefficient"] == 0.02


def test_only_what_was_found_is_changed(rig: Path) -> None:
    path = rig.with_name("rod.urdf")
    described, text = read_mechanism(path, {"torque": "hinge"}), XmlText.read(path)
    values = {
        "rod_mass": 0.6,
        "viscous_friction.coefficient": 0.02,
        "coulomb_friction.level": 0.05,
        "added_inertia.inertia": 0.004,
        "cubic_viscous_friction.coefficient": 1e-3,
    }
    found = patch_urdf(described, text, values)
    assert set(found.remaining) == {"cubic_viscous_friction.coefficient"}
    lines = list(zip(FILE.splitlines(), text.changed().decode().splitlines(), strict=False))
    assert lines[:5] == [(line, line) for line in FILE.splitlines()[:5]]
    new = path.with_name("new.urdf")
    new.write_bytes(text.changed())
    model, before = mujoco.MjModel.from_xml_path(str(new)), described.model
    assert model.body_mass[1] == pytest.approx(0.6, rel=1e-5)  # the bob that is screwed on with it
    assert model.dof_damping[0] == 0.02
    assert model.dof_frictionloss[0] == 0.05
    assert model.dof_M0[0] == pytest.approx(1.5 * before.dof_M0[0] + 0.004, rel=1e-4)


def test_a_shorter_step_is_said_where_other_readers_pass_over_it(rig: Path) -> None:
    path = rig.with_name("rod.urdf")
    described, text = read_mechanism(path, {"torque": "hinge"}), XmlText.read(path)
    shorten_urdf_step(described, text, 4)
    new = path.with_name("new.urdf")
    new.write_bytes(text.changed())
    assert mujoco.MjModel.from_xml_path(str(new)).opt.timestep == pytest.approx(0.0005)


def test_firm_friction_is_told_beside_a_file_that_cannot_say_it() -> None:
    code = companion_text(sort_effects({}), "new.urdf", Usage.in_mujoco("torque"), 1e-4, firm=True)
    assert "model.dof_solref[:] = 2.0 * model.opt.timestep, 1.0" in code
    compile(code, "new_effects.py", "exec")


@pytest.mark.extended
def test_a_repaired_urdf_keeps_the_promise(tmp_path: Path, rig: Path) -> None:
    random = np.random.default_rng(5)
    t = np.arange(0.0, 20.0, 0.01)
    torque = torques(t, random)
    angle = swung(t, torque, dry=0.03) + 1e-3 * random.standard_normal(len(t))
    run = tmp_path / "run.mcap"
    lh.recording(t, {"torque": torque}, {"angle": angle}, rig=rig).save(run)
    found = lh.fit(run, rig, terms=["viscous_friction", "coulomb_friction", "added_inertia"])
    fixed = found.patch(tmp_path / "rod.urdf", tmp_path / "fixed.urdf", rig=rig)
    assert fixed.attempts[-1].ratio <= MAX_ERROR_RATIO
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.urdf"))
    assert model.dof_damping[0] == pytest.approx(DRAG, rel=0.05)
    assert model.dof_frictionloss[0] == pytest.approx(0.03, rel=0.05)
    assert model.dof_M0[0] == pytest.approx(INERTIA, rel=0.01)
    centre = float(np.linalg.norm(model.body_ipos[1]))
    assert model.body_mass[1] * centre * 9.81 == pytest.approx(GRAVITY, rel=0.01)
    assert (tmp_path / "rod.urdf").read_text(encoding="utf-8") == FILE
