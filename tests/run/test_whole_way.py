"""From a bench to a named effect: `labhil run`, `diagnose` and `fit` of a twin that conceals something."""

import json
import os
import subprocess
import sys
from importlib.resources import files

import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

pytestmark = [pytest.mark.by_hand, pytest.mark.timeout(1800)]

BASELINE = "viscous_friction,coulomb_friction"
SEEDS = {"identify": "seed = 1", "test": "seed = 2"}
TRUTH = {
    "solenoid": {"spring_stiffness": 6850.0, "viscous_friction.coefficient": 5.0},
    "dc_motor": {"resistance": 1.5, "viscous_friction.coefficient": 0.05},
}


def labhil(folder, *arguments):
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path))
    done = subprocess.run(
        [*PATIENT_LABHIL, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def recorded(folder, rig, terms):
    """Both shipped experiments of a rig on a twin made of these terms; gives the recordings."""
    examples = files("labhil.experiment") / "examples"
    (folder / f"{rig}.toml").write_text((examples / f"{rig}.toml").read_text(encoding="utf-8"))
    paths = []
    for what, seed in SEEDS.items():
        text = (examples / f"{rig}_{what}.toml").read_text(encoding="utf-8")
        assert seed in text
        (folder / f"{what}.toml").write_text(text.replace(seed, f"{seed}, terms = {json.dumps(terms)}"))
        paths.append(labhil(folder, "run", f"{what}.toml").splitlines()[-1])
    return paths


@pytest.mark.parametrize(
    ("rig", "concealed", "enters"),
    [
        ("solenoid", "eddy_current", "magnetic"),
        ("solenoid", "stribeck_friction", "force"),
        ("dc_motor", "brush_drop", "electrical"),
        ("dc_motor", "cogging_torque", "force"),
    ],
)
def test_what_a_twin_conceals_is_named(tmp_path, rig, concealed, enters):
    search, test = recorded(tmp_path, rig, [*BASELINE.split(","), concealed])
    told = ("--test", test, "--json", "out.json")
    labhil(tmp_path, "diagnose", search, "--baseline", BASELINE, *told)
    found = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "missing_physics"
    assert [item["term"] for item in found["missing"]] == [concealed]
    assert found["location"]["enters"] == enters
    assert found["improvement"]["rmse_after"] < 1.1 * found["improvement"]["noise_floor"]
    labhil(tmp_path, "fit", search, "--terms", f"{BASELINE},{concealed}", *told)
    rows = {row["name"]: row for row in json.loads((tmp_path / "out.json").read_text())["parameters"]}
    for name, truth in TRUTH[rig].items():
        assert rows[name]["value"] == pytest.approx(truth, rel=0.05), name
