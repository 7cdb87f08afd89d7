"""What a diagnosis says of measured data whose baseline lacks what is known to be there.

The page is docs/reference/measured-diagnoses.md.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RIGS = ROOT / "docs" / "measured"
DATA = Path(os.environ.get("LABHIL_DATA") or ROOT.parent / "shared" / "data")

pytestmark = [pytest.mark.by_hand, pytest.mark.timeout(2400)]  # nine to eighteen minutes each


@pytest.fixture
def diagnosed(labhil, tmp_path):
    """Import a table and diagnose it: the JSON. Skips where the measured data are not."""

    def answer(table, rig, *arguments):
        source = DATA / table
        if not source.is_file():
            pytest.skip(f"measured data are not here: {source} (set LABHIL_DATA to their folder)")
        assert labhil("import", source, "--rig", RIGS / rig, "-o", "measured.mcap").status == 0
        done = labhil("diagnose", "measured.mcap", "--rig", RIGS / rig, "--json", "said.json", *arguments)
        assert done.status == 0, done.err
        return json.loads((tmp_path / "said.json").read_text(encoding="utf-8"))

    return answer


def test_friction_of_a_worn_screw_differs_by_direction(diagnosed):
    """EMPS: viscous friction of 167 and 241 N·s/m is 204 with an asymmetry of −37, say its authors."""
    symmetric = "viscous_friction,coulomb_friction,constant_force"
    said = diagnosed("axis_emps/DATA_EMPS.mat", "emps.toml", "--baseline", symmetric)
    # a screw has more to it than that: a force without a name may stand beside it, and leaves its size known
    named = [found["term"] for found in said["missing"] if found["term"] != "unmodelled_force"]
    assert named == ["friction_asymmetry"]
    rows = {row["name"]: row for row in said["final"]["parameters"]}
    asymmetry, viscous = rows["friction_asymmetry.coefficient"], rows["viscous_friction.coefficient"]
    assert asymmetry["significant"]
    assert asymmetry["ci99"][0] < -37.0 < asymmetry["ci99"][1]
    forwards, backwards = (viscous["value"] + sign * asymmetry["value"] for sign in (1.0, -1.0))
    assert forwards == pytest.approx(167.0, rel=0.07)
    assert backwards == pytest.approx(241.0, rel=0.07)
    assert said["improvement"]["rmse_after"] < 0.5 * said["improvement"]["rmse_before"]


def test_a_geared_motor_has_dry_friction(diagnosed):
    """A staircase of voltages both ways: its authors say dead zone, its coast-down dry friction."""
    said = diagnosed("dc_motor_dead_zone/run_minimal.csv", "dc_motor.toml")
    (found,) = said["missing"]
    assert found["term"] == "coulomb_friction"
    assert said["p_value"] < 1e-9
    assert said["improvement"]["rmse_after"] < 0.5 * said["improvement"]["rmse_before"]
