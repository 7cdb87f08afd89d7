"""The tutorial of a user's own FMU does what it says: its blocks are run as they stand."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import labhil as lh
from labhil.python_file import module_of

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "fmu"))
from pendulum_fmu import built
from pendulum_plant import DRAG, GRAVITY, INERTIA, swung, torques

PAGE = (Path(__file__).parents[2] / "docs" / "tutorials" / "your-own-fmu.md").read_text(encoding="utf-8")
DRY, LATE = 0.03, 3


def block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return str(found)


@pytest.mark.extended
@pytest.mark.timeout(1800)
@pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler here to build an FMU with: apt install gcc"
)
def test_the_tutorial_ends_with_a_repaired_fmu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bench whose inertia, gravity, drag, dry friction and dead time are none of the FMU's."""
    monkeypatch.chdir(tmp_path)
    built(tmp_path, version=3)
    Path("rig.toml").write_text(block("toml"), encoding="utf-8")
    random = np.random.default_rng(5)
    t = np.arange(0.0, 20.0, 0.01)
    torque = torques(t, random)
    angle = swung(t, torque, dry=DRY, late=LATE) + 1e-3 * random.standard_normal(len(t))
    lh.recording(t, {"torque": torque}, {"angle": angle}, rig="rig.toml").save("run.mcap")
    names: dict[str, Any] = {}
    exec(block("python"), names)
    assert {effect.term for effect in names["found"].missing} == {"coulomb_friction", "time_delay"}
    assert names["fixed"].attempts[-1].ratio <= 1.05
    functions = module_of(Path("rod_fixed_effects.py"))
    expected = {"inertia": INERTIA, "gravity_torque": GRAVITY, "drag": DRAG}
    assert pytest.approx(expected, rel=0.05) == functions.PARAMETERS
    assert functions.force(0.0, 1.0) == pytest.approx(-DRY, rel=0.05)
