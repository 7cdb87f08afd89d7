"""A real UR10e against a MuJoCo file of the manufacturer's masses: diagnosed, repaired, run by MuJoCo.

The built-in arm, which estimates inertia from nothing, is the yardstick on the same held-out data.
"""

from __future__ import annotations

import json
import os
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


@pytest.mark.extended
@pytest.mark.timeout(900)
def test_a_repaired_file_predicts_currents_as_well_as_the_built_in_arm(
    labhil: Any, tmp_path: Path, data: Path
) -> None:
    rigs = {"own": MEASURED / "ur10e_mujoco.toml", "built_in": MEASURED / "ur10e.toml"}
    found = {}
    for name, rig in rigs.items():
        assert labhil("import", data / RUN, "--rig", rig, "-o", f"{name}.mcap").status == 0
        done = labhil("diagnose", f"{name}.mcap", "--rig", rig, "--json", f"{name}.json")
        assert done.status == 0, done.err
        found[name] = json.loads((tmp_path / f"{name}.json").read_text())
    out, into = tmp_path / "fixed.xml", MEASURED / "ur10e.xml"
    done = labhil(
        "patch", "own.json", "--into", into, "-o", out, "--rig", rigs["own"], "--json", "patch.json"
    )
    assert done.status == 0, done.err
    patch = json.loads((tmp_path / "patch.json").read_text())
    repaired = np.array([joint["after"] for joint in patch["joints"]])
    built_in = np.array([row["rmse_after"] for row in found["built_in"]["improvement"]["per_channel"]])
    assert np.all(repaired <= 1.1 * built_in), (repaired, built_in)
    assert patch["ratio"] <= 1.05
    assert all(joint["after"] < 0.1 * joint["before"] for joint in patch["joints"])
    # gears that rub under their load: shoulder and elbow, as without the manufacturer's masses
    loaded = {m["joint"] for m in found["own"]["missing"] if m["term"] == "load_dependent_friction"}
    assert loaded == {1, 2}
    # every joint rubs and has a rotor, none of which the file has
    changed = {(c["name"], c["joint"]) for c in found["own"]["changed"] if c["before"] == 0.0}
    for name in ("viscous_friction.coefficient", "coulomb_friction.level", "added_inertia.inertia"):
        assert {joint for kind, joint in changed if kind == name} == set(range(6)), name
    model = mujoco.MjModel.from_xml_path(str(out))
    assert np.all(model.dof_frictionloss > 1.0)
    assert np.all(model.dof_armature > 0.3)
