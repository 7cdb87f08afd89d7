"""A third party's model: stated by its right-hand side, found by entry point, fitted like any other."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from labhil.identify.fit import Options, fit
from labhil.physics.record import Record, Windows
from labhil.physics.right_hand_side import RightHandSide
from labhil.physics.terms import Enters, Parameter, Term
from labhil.rig import default_rig

TANK = RightHandSide(
    states={"level": 0.05},
    # a tank with a pump and a hole: Torricelli's law
    derivative=lambda t, x, u, p: (p["gain"] * u - p["leak.area"] * np.sqrt(np.maximum(x, 1e-6))) / p["area"],
    output=lambda x, u, p: x,
    guess=lambda t, y: y[0],
    parameters=(
        Parameter("area", "m²", 0.1, 1e-3, 10.0, starts=(0.2,)),
        Parameter("gain", "m³/(V·s)", 0.01, 1e-4, 1.0, starts=(0.02,)),
    ),
    horizon=10.0,
    terms=(
        Term(
            "leak", Enters.FORCE, "a hole", "q = a·√h", "Torricelli", "different levels",
            (Parameter("leak.area", "m²·√m/s", 0.01, 0.0, starts=(0.01,)),),
        ),
    ),
)  # fmt: skip

PACKAGE = """
from labhil.kinds import Known, RigKind
from labhil.signals import Direction, Hold, Signal
from labhil.physics.right_hand_side import RightHandSide
from labhil.physics.terms import Parameter
TANK = RigKind(
    "tank", (Signal("pump", "V", Direction.INPUT, hold=Hold.ZERO),), (("pump",),),
    (Signal("level", "m", Direction.OUTPUT),), {"area": Known("m²")},
)
MODEL = RightHandSide(
    states={"level": 0.05}, derivative=lambda t, x, u, p: (p["gain"] * u - 0.01 * x) / p["area"],
    output=lambda x, u, p: x, guess=lambda t, y: y[0],
    parameters=(
        Parameter("area", "m²", 0.1, 1e-3, 10.0, starts=(0.2,)),
        Parameter("gain", "m³/(V·s)", 0.01, 1e-4, 1.0, starts=(0.02,)),
    ),
    horizon=5.0,
)
"""


@pytest.fixture(scope="module")
def record() -> Record:
    period, n = 0.1, 800
    random = np.random.default_rng(5)
    pump = np.repeat(random.uniform(0.0, 1.0, n // 50), 50)
    level = np.empty(n)
    level[0] = 0.3
    for i in range(n - 1):
        h = level[i]
        for _ in range(20):
            h += period / 20 * (0.03 * pump[i] - 0.02 * np.sqrt(max(h, 1e-6))) / 0.15
        level[i + 1] = h
    measured = level + 0.002 * random.standard_normal(n)
    return Record(period * np.arange(n), pump[:, None], measured[:, None], ("pump",), ("level",), ("m",))


@pytest.mark.extended
def test_a_stated_right_hand_side_is_fitted_and_its_scale_is_told_to_be_unknown(record):
    model = TANK(default_rig("ball_beam"))
    result = fit(model, record, ("leak",), options=Options(window=15.0, estimator="nlse"))
    values = {row.name: row for row in result.estimates}
    # only ratios matter: q/A and a/A
    assert values["gain"].value / values["area"].value == pytest.approx(0.03 / 0.15, rel=0.02)
    assert values["leak.area"].value / values["area"].value == pytest.approx(0.02 / 0.15, rel=0.02)
    assert result.identifiability.rank == 2
    assert not any(row.identifiable for row in result.estimates)


def test_windows_of_different_length_are_simulated_as_they_are_by_themselves(record):
    model = TANK(default_rig("ball_beam"))
    theta = np.array([0.15, 0.03, 0.02])
    spans = [(0, 40), (40, 140), (140, 150)]
    together = Windows.of(spans)
    whole = model.simulate(theta, record, together, model.initial_states(record, together))
    for w, span in enumerate(spans):
        alone = Windows.of([span])
        part = model.simulate(theta, record, alone, model.initial_states(record, alone))
        assert np.array_equal(whole[together.owner == w], part)


@pytest.mark.extended
def test_a_package_brings_a_rig_kind_and_its_model(tmp_path: Path):
    (tmp_path / "tank_rig.py").write_text(PACKAGE)
    told = tmp_path / "tank_rig-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: tank-rig\nVersion: 1.0\n")
    points = "[labhil.rigs]\ntank = tank_rig:TANK\n[labhil.models]\ntank = tank_rig:MODEL\n"
    (told / "entry_points.txt").write_text(points)
    rows = "\n".join(f"{0.1 * i:.1f},{(i // 40) % 2},{0.4 + 0.1 * np.sin(0.05 * i):.4f}" for i in range(400))
    (tmp_path / "tank.csv").write_text("t,pump,level\n" + rows + "\n")
    (tmp_path / "tank.toml").write_text('[rig]\nkind = "tank"\n[known]\narea = 0.15\n')
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}

    def labhil(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "labhil", *arguments],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    labhil("import", "tank.csv", "--rig", "tank.toml", "-o", "tank.mcap")
    assert "gain" in labhil("fit", "tank.mcap")
    assert "tank" in labhil("terms")
