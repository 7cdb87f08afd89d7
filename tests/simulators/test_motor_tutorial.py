"""The tutorial of a user's own motor does what it says: its blocks are run as they stand."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import labhil as lh
from labhil.simulators.simulator import Simulator

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "motor"))
from motor_bench import FILE, HIDDEN, main, record

PAGE = (Path(__file__).parents[2] / "docs" / "tutorials" / "your-own-motor-file.md").read_text(
    encoding="utf-8"
)


def block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return str(found)


def recorded(folder: Path) -> None:
    """The files of the page in a folder, and the recording that is imported there."""
    main(folder)
    (folder / "rig.toml").write_text(block("toml"), encoding="utf-8")
    lh.read(folder / "run.csv", rig=folder / "rig.toml").save(folder / "run.mcap")


def assert_repaired(path: Path) -> None:
    """The file has the cogging and the friction that the bench keeps to itself."""
    model = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(model.actuator_biasprm[0][:3], [0.0006, 12.0, 0.4], rtol=0.05)
    assert model.dof_frictionloss[0] == pytest.approx(0.0006, rel=0.05)


def test_the_page_states_the_file_and_what_the_bench_hides(tmp_path: Path) -> None:
    assert all(line in PAGE for line in re.findall(r"<(?:joint|dcmotor) [^>]*>", FILE.read_text("utf-8")))
    assert all(attribute in PAGE for attribute in re.findall(r'\w+="[^"]*"', HIDDEN))
    main(tmp_path)
    assert not re.search("cogging|lugre", (tmp_path / "motor.xml").read_text(encoding="utf-8"))
    table = np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table, np.column_stack(record()), rtol=1e-8, atol=1e-12)


@pytest.mark.extended
@pytest.mark.timeout(1800)
def test_the_tutorial_ends_with_a_repaired_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cogging and bristles are named, and MuJoCo runs the file with both."""
    monkeypatch.chdir(tmp_path)
    recorded(tmp_path)
    names: dict[str, Any] = {}
    exec(block("python"), names)
    named = {effect.term for effect in names["found"].missing}
    assert named == {"cogging_torque", "coulomb_friction", "presliding_friction"}
    assert names["fixed"].attempts[-1].ratio <= 1.05
    assert_repaired(tmp_path / "motor_fixed.xml")


@pytest.mark.extended
@pytest.mark.timeout(900)
def test_a_fit_of_the_named_effects_with_the_simulator_ends_with_the_same_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a rig file: the simulator is given to the fit and to the patch."""
    monkeypatch.chdir(tmp_path)
    recorded(tmp_path)
    rig = lh.mujoco_simulator("motor.xml", inputs={"voltage": "motor"}, outputs={"angle": "shaft"})
    assert isinstance(rig, Simulator)
    fit = lh.fit("run.mcap", rig, terms=["coulomb_friction", "cogging_torque"])
    fixed = fit.patch("motor.xml", "motor_fixed.xml", rig=rig)
    assert fixed.attempts[-1].ratio <= 1.05
    assert_repaired(tmp_path / "motor_fixed.xml")
