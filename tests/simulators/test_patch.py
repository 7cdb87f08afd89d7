"""A repaired file: only what was found is changed, and MuJoCo itself keeps the promise."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import mujoco
import pytest

import labhil as lh
from labhil.analysis.patch import MAX_ERROR_RATIO
from labhil.analysis.patching import patch
from labhil.errors import ModelFileError, RecordingError, UsageError
from labhil.physics.rigs import model_for
from labhil.simulators.companion import Usage, companion_text, sort_effects
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.patches import patch_mjcf
from labhil.simulators.xml_text import XmlText

sys.path.insert(0, str(Path(__file__).parent))
from pendulum_file import FILE, bench, recorded

SPRUNG = """<mujoco model="door">
  <worldbody>
    <body name="door">
      <joint name='hinge' type="hinge" axis="0 0 1" stiffness="2" springref="30" damping="1 2"
             frictionloss='0.3'/>
      <geom type="box" size="0.4 0.02 1" pos="0.4 0 0"/>  <!-- > a leaf -->
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" gear="2"/></actuator>
</mujoco>
"""


def test_a_number_that_differs_by_rounding_stays_as_it_was_written() -> None:
    text = XmlText.of(Path("file.xml"), b'<body pos="0.10 -8e-05 1" mass="2.50" name="2.5" size="0 0"/>')
    (body,) = text.elements
    text.set(body, "pos", "0.1 -7.99999999e-05 1.5", "moved")
    text.set(body, "mass", "2.5", "the same")
    text.set(body, "name", "2.5 a", "renamed")
    text.set(body, "size", "-6e-15 9e-18", "of a fit")
    assert text.changed() == b'<body pos="0.10 -8e-05 1.5" mass="2.50" name="2.5 a" size="0 0"/>'
    assert [change.attribute for change in text.changes] == ["pos", "name"]


def edited(tmp_path: Path, file: str, values: dict[str, float]) -> tuple[str, dict[str, float]]:
    path = tmp_path / "file.xml"
    path.write_text(file, encoding="utf-8")
    found = patch_mjcf(read_mechanism(path), XmlText.read(path), values)
    return found.text.changed().decode(), dict(found.remaining)


def test_all_but_the_changed_attributes_stays_as_it_was_written(tmp_path: Path) -> None:
    values = {"coulomb_friction.level": 0.25, "viscous_friction.coefficient": 1.5}
    text, left = edited(tmp_path, SPRUNG, values | {"quadratic_viscous_friction.coefficient": 2.0})
    expected = SPRUNG.replace("'0.3'", "'0.25'").replace('"1 2"', '"1.5 2"')
    assert text == expected
    assert not left


def test_springs_angles_and_masses_are_in_the_units_of_the_file(tmp_path: Path) -> None:
    text, left = edited(
        tmp_path, SPRUNG, {"stiffness": 3.0, "springref": 0.1, "door_mass": 40.0, "time_delay.delay": 0.01}
    )
    (tmp_path / "new.xml").write_text(text, encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    assert not left
    assert model.jnt_stiffness[0] == 3.0
    assert model.qpos_spring[0] == pytest.approx(0.1, rel=1e-5)
    assert model.body_mass[1] == pytest.approx(40.0, rel=1e-5)
    assert model.dof_frictionloss[0] == 0.0  # the result does without: it was in the file
    assert model.actuator_delay[0] == 0.01


def test_what_the_format_cannot_hold_is_a_function_with_its_law(tmp_path: Path) -> None:
    values = {
        "coulomb_friction.level": 0.3,
        "stribeck_friction.level": 0.2,
        "stribeck_friction.velocity": 0.1,
    }
    text, left = edited(tmp_path, SPRUNG, values | {"dead_zone.left": 0.1, "dead_zone.right": 0.2})
    assert "frictionloss='0.5'" in text  # it holds with both, and the function gives one of them back
    code = companion_text(sort_effects(left), "new.xml", Usage.in_mujoco("torque"), 1e-4)
    names: dict[str, object] = {}
    exec(code, names)
    force, command = names["force"], names["Command"]
    assert force(0.0, 0.0) == 0.0  # type: ignore[operator]
    assert force(0.0, 5.0) == pytest.approx(0.2)  # type: ignore[operator]
    assert force(0.0, -5.0) == pytest.approx(-0.2)  # type: ignore[operator]
    assert command()(0.5, 0.01) == pytest.approx(0.3)  # type: ignore[operator]
    assert "F = -F_st exp(-|v| / v_s) sgn v" in code
    assert "= effects.force(data.qpos[0], data.qvel[0])\n" in code


def test_friction_that_grows_with_the_load_is_given_the_load() -> None:
    effects = sort_effects({"load_dependent_friction.coefficient": 0.1})
    code = companion_text(effects, "new.xml", Usage.in_mujoco("torque"), 1e-4)
    assert "= effects.force(data.qpos[0], data.qvel[0], data.qfrc_actuator[0])\n" in code
    names: dict[str, object] = {}
    exec(code, names)
    assert names["force"](0.0, 5.0, -2.0) == pytest.approx(-0.2)  # type: ignore[operator]


def test_a_urdf_is_to_be_saved_as_mjcf_first(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="arm"><link name="base"/><joint name="elbow" type="continuous"><parent link="base"/>'
        '<child link="rod"/><axis xyz="0 1 0"/><dynamics damping="0.1" friction="0.2"/></joint>'
        '<link name="rod"><inertial><origin xyz="0 0 -0.1"/><mass value="0.4"/><inertia ixx="0.02" '
        'iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>',
        encoding="utf-8",
    )
    described = read_mechanism(path, {"torque": "elbow"}, {"angle": "elbow"})
    assert described.simulator.nominal["coulomb_friction.level"] == 0.2
    with pytest.raises(UsageError, match="expected an MJCF file"):
        patch_mjcf(described, XmlText.read(path), {"viscous_friction.coefficient": 0.2})


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the file, its rig file, a recording without dry friction, and a fit of it."""
    folder = tmp_path_factory.mktemp("patched")
    rig = bench(folder)
    run = recorded(rig, seed=5, seconds=8.0)
    lh.fit(run, rig, terms=["viscous_friction", "added_inertia"]).save(folder / "fit.json")
    return folder


@pytest.mark.extended
def test_the_repaired_file_keeps_the_promise_and_the_old_one_stays(fitted: Path, tmp_path: Path) -> None:
    out = tmp_path / "fixed.xml"
    found = patch(fitted / "fit.json", fitted / "rod.xml", out, fitted / "rig.toml")
    assert found.attempts[-1].ratio <= MAX_ERROR_RATIO
    assert found.before > 3.0 * found.attempts[-1].rmse
    assert (fitted / "rod.xml").read_text(encoding="utf-8") == FILE
    text = out.read_text(encoding="utf-8")
    assert "<!-- ball bearing, taken for free of friction -->" in text
    model = mujoco.MjModel.from_xml_path(str(out))
    assert model.dof_damping[0] == pytest.approx(0.012, rel=0.05)
    assert model.body_mass[1] == pytest.approx(0.45 / 0.981, rel=0.01)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fixed.xml"]
    with pytest.raises(UsageError, match="nothing is overwritten"):
        patch(fitted / "fit.json", fitted / "rod.xml", out, fitted / "rig.toml")


@pytest.mark.extended
def test_a_result_in_python_is_put_into_the_file_by_itself(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the very file that the command writes."""
    monkeypatch.chdir(fitted)
    fit = lh.load("fit.json")
    assert isinstance(fit, lh.Fit)
    found = fit.patch("rod.xml", tmp_path / "fixed.xml", rig="rig.toml")
    by_command = patch(Path("fit.json"), Path("rod.xml"), tmp_path / "same.xml", Path("rig.toml"))
    assert (tmp_path / "fixed.xml").read_bytes() == (tmp_path / "same.xml").read_bytes()
    assert found.to_dict()["rmse_after"] == by_command.to_dict()["rmse_after"]
    assert found.left == ()
    with pytest.raises(UsageError, match="nothing is overwritten"):
        fit.patch("rod.xml", tmp_path / "fixed.xml", rig="rig.toml")


@pytest.mark.extended
def test_a_result_takes_the_simulator_that_it_was_found_with(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The signals have other names than in the file; the simulator says which is which."""
    monkeypatch.chdir(fitted)
    fit = lh.load("fit.json")
    assert isinstance(fit, lh.Fit)
    with pytest.raises(RecordingError, match="needs encoder and motor in one stream"):
        fit.patch("rod.xml", tmp_path / "none.xml")
    rod = lh.mujoco_simulator("rod.xml", inputs={"torque": "motor"}, outputs={"angle": "encoder"})
    before = [parameter.key for parameter in model_for(rod.rig_file).parameters]
    found = fit.patch("rod.xml", tmp_path / "fixed.xml", rig=rod)
    assert found.attempts[-1].ratio <= MAX_ERROR_RATIO
    # the repaired file has parameters that the simulator has not, and the same name
    assert [parameter.key for parameter in model_for(rod.rig_file).parameters] == before
    fit.patch("rod.xml", tmp_path / "same.xml", rig=lh.model(rod, known={"gear": 1.0}))
    assert (tmp_path / "fixed.xml").read_bytes() == (tmp_path / "same.xml").read_bytes()


@pytest.mark.extended
def test_a_result_of_other_values_or_of_another_recording_is_refused(fitted: Path, tmp_path: Path) -> None:
    data = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    wrong = fitted / "wrong.json"
    for row in data["parameters"]:
        if row["name"] == "rod_mass":
            row["value"] *= 1.2
    wrong.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(UsageError, match="promises an error of"):
        patch(wrong, fitted / "rod.xml", tmp_path / "fixed.xml", fitted / "rig.toml")
    data["recordings"][0]["sha256"] = "0" * 64
    wrong.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(UsageError, match="expected the recording that"):
        patch(wrong, fitted / "rod.xml", tmp_path / "fixed.xml", fitted / "rig.toml")
    wrong.write_text('{"schema": "labhil.verification/1"}', encoding="utf-8")
    with pytest.raises(ModelFileError, match=r"expected labhil.diagnosis/1 or labhil.fit/1"):
        patch(wrong, fitted / "rod.xml", tmp_path / "fixed.xml", fitted / "rig.toml")
    assert not list(tmp_path.iterdir())
