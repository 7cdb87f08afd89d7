"""The tutorial of a user's own MuJoCo file does what it says: its blocks are run as they stand."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import labhil as lh

sys.path.insert(0, str(Path(__file__).parent))
from pendulum_plant import DRAG, swung, torques

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tutorials" / "your-own-mujoco-file.md").read_text(encoding="utf-8")
DRY = 0.03


def block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return str(found)


@pytest.mark.extended
@pytest.mark.timeout(600)
def test_the_tutorial_ends_with_a_repaired_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a bench whose inertia, gravity, damping and dry friction are none of the file's."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "examples" / "pendulum.xml", "pendulum.xml")
    Path("rig.toml").write_text(block("toml"), encoding="utf-8")
    random = np.random.default_rng(3)
    t = np.arange(0.0, 20.0, 0.01)
    torque = torques(t, random)
    angle = swung(t, torque, dry=DRY) + 1e-3 * random.standard_normal(len(t))
    lh.recording(t, {"torque": torque}, {"angle": angle}, rig="rig.toml").save("run.mcap")
    names: dict[str, Any] = {}
    exec(block("python"), names)
    assert {effect.term for effect in names["found"].missing} == {"coulomb_friction", "added_inertia"}
    # the inertia is no force of the mechanism: it is not located where rounding is
    assert all(r.unit != "N·m" or r.high > 1e-6 for r in names["found"].where.regimes)
    assert names["fixed"].attempts[-1].ratio <= 1.05
    assert "frictionloss=" in capsys.readouterr().out
    model = mujoco.MjModel.from_xml_path("pendulum_fixed.xml")
    assert model.dof_frictionloss[0] == pytest.approx(DRY, rel=0.03)
    assert model.dof_damping[0] == pytest.approx(DRAG, rel=0.05)
    assert model.body_mass[1] == pytest.approx(0.45 / (9.81 * 0.15), rel=0.01)
