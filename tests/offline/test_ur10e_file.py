"""A real UR10e against a MuJoCo file of the manufacturer's masses: diagnosed, repaired, run by MuJoCo.

The built-in arm, which estimates inertia from nothing, is the yardstick on the same held-out data.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
MEASURED = ROOT / "docs" / "measured"
PAGE = ROOT / "docs" / "tutorials" / "your-own-arm.md"
RUN = "ur-20_02_10-30sec_12harm.csv"


@pytest.fixture(scope="module")
def data() -> Path:
    """The folder of the recordings; skip where it is not."""
    folder = Path(os.environ.get("LABHIL_DATA") or ROOT.parent / "shared" / "data") / "arm_ur10e"
    if not folder.is_dir():
        pytest.skip(f"measured data are not here: {folder} (set LABHIL_DATA to the folder above it)")
    return folder


def block(language: str) -> str:
    """The only code block of a language on the tutorial's page."""
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return str(found)


@pytest.mark.extended
@pytest.mark.timeout(900)
def test_the_tutorials_arm_is_repaired_and_as_good_as_the_built_in_one(
    labhil: Any, tmp_path: Path, data: Path
) -> None:
    """Its blocks are run as they stand."""
    shutil.copy(MEASURED / "ur10e.xml", tmp_path)
    (tmp_path / "rig.toml").write_text(block("toml"), encoding="utf-8")
    assert labhil("import", data / RUN, "--rig", "rig.toml", "-o", "run.mcap").status == 0
    names: dict[str, Any] = {}
    exec(block("python"), names)
    found, fixed = names["found"], names["fixed"]
    rig = MEASURED / "ur10e.toml"
    assert labhil("import", data / RUN, "--rig", rig, "-o", "built_in.mcap").status == 0
    assert labhil("diagnose", "built_in.mcap", "--rig", rig, "--json", "built_in.json").status == 0
    scored = json.loads((tmp_path / "built_in.json").read_text())["improvement"]["per_channel"]
    built_in = np.array([row["rmse_after"] for row in scored])
    repaired = np.array([joint.after for joint in fixed.joints])
    assert np.all(repaired <= 1.1 * built_in), (repaired, built_in)
    assert fixed.attempts[-1].ratio <= 1.05
    assert all(joint.after < 0.1 * joint.before for joint in fixed.joints)
    # gears that rub under their load: shoulder and elbow, as without the manufacturer's masses
    assert {m.joint for m in found.missing if m.term == "load_dependent_friction"} == {1, 2}
    # every joint rubs and has a rotor, none of which the file has
    changed = {(c.name, c.joint) for c in found.changed if c.before == 0.0}
    for name in ("viscous_friction.coefficient", "coulomb_friction.level", "added_inertia.inertia"):
        assert {joint for kind, joint in changed if kind == name} == set(range(6)), name
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "ur10e_fixed.xml"))
    assert np.all(model.dof_frictionloss > 1.0)
    assert np.all(model.dof_armature > 0.3)
    (tmp_path / "diagnosis.json").write_text(json.dumps(found.to_dict()), encoding="utf-8")
    (command,) = re.findall(r"```sh\nlabhil (patch .*?)\n```", PAGE.read_text(encoding="utf-8"))
    (tmp_path / "ur10e_fixed.xml").unlink()
    (tmp_path / "ur10e_fixed_effects.py").unlink()
    done = labhil(*command.split())
    assert done.status == 0, done.err
    assert "shoulder_pan: " in done.out
