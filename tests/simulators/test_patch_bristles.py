"""Dry friction on bristles in a user's pendulum: named, and written beside a repaired file with its state."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import labhil as lh
from labhil.analysis.patch import MAX_ERROR_RATIO
from labhil.python_file import module_of
from labhil.signals import FloatArray
from labhil.simulators.companion import Usage, companion_text, sort_effects
from labhil.simulators.patches import with_shared_values

sys.path.insert(0, str(Path(__file__).parent))
from pendulum_file import bench
from pendulum_plant import DRAG, GRAVITY, INERTIA, torques

DRY, LENGTH, TIME_CONSTANT, PERIOD = 0.03, 4e-3, 2e-3, 0.01
BENCH = """import math

import labhil as lh


def rates(t, x, u, p):
    return x.rate, (u.torque - p.gravity_torque * math.sin(x.angle) - p.drag * x.rate) / p.inertia


pendulum = lh.simulator(
    rates, name="pendulum", states={"angle": "rad", "rate": "rad/s"}, inputs={"torque": "N·m"},
    parameters=dict(inertia=lh.Quantity(2.0e-2, "kg·m²"), gravity_torque=lh.Quantity(0.5, "N·m"), drag=0.01),
)
"""


def swung_on_bristles(t: FloatArray, u: FloatArray, *, parts: int = 50) -> FloatArray:
    """Angles (n,) of the plant with LuGre friction, in short steps."""
    x, v, z, h = 0.0, 0.0, 0.0, PERIOD / parts
    angles = np.zeros(len(t))
    for k in range(len(t)):
        angles[k] = x
        for _ in range(parts):
            rate = (v - abs(v) * z) / LENGTH
            dry = DRY * (z + TIME_CONSTANT * rate)
            v += h * (u[k] - GRAVITY * np.sin(x) - DRAG * v - dry) / INERTIA
            x += h * v
            z += h * rate
    return angles


def recorded(rig: lh.Simulator | Path) -> lh.Recording:
    """12 s at 100 Hz with 1 mrad of noise: four presliding lengths."""
    random = np.random.default_rng(5)
    t = np.arange(0.0, 12.0, PERIOD)
    u = torques(t, random)
    angle = swung_on_bristles(t, u) + 1e-3 * random.standard_normal(len(t))
    return lh.recording(t, {"torque": u}, {"angle": angle}, rig=rig)


TERMS = ["coulomb_friction", "presliding_friction"]


@pytest.mark.extended
def test_a_pendulum_in_python_is_named_and_repaired(tmp_path: Path) -> None:
    path = tmp_path / "bench.py"
    path.write_text(BENCH, encoding="utf-8")
    rig = module_of(path).pendulum
    found = lh.diagnose(recorded(rig), rig, baseline=[])
    assert {effect.term for effect in found.missing} == set(TERMS)
    sizes = {p.name: p for p in found.final.parameters}
    for name, truth in {
        "coulomb_friction.level": DRY, "presliding_friction.length": LENGTH, "inertia": INERTIA,
        "gravity_torque": GRAVITY,
    }.items():  # fmt: skip
        low, high = sizes[name].ci99
        assert low <= truth <= high, name
    fixed = found.patch(f"{path}:pendulum", tmp_path / "fixed.py")
    assert fixed.attempts[-1].ratio <= MAX_ERROR_RATIO


@pytest.mark.extended
def test_a_mujoco_file_leaves_the_dry_friction_to_its_bristles(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    recorded(rig).save(tmp_path / "run.mcap")
    fit = lh.fit(lh.read(tmp_path / "run.mcap"), rig, terms=["viscous_friction", "added_inertia", *TERMS])
    fixed = fit.patch(tmp_path / "rod.xml", tmp_path / "fixed.xml", rig=rig)
    assert fixed.attempts[-1].ratio <= MAX_ERROR_RATIO
    assert "frictionloss" not in (tmp_path / "fixed.xml").read_text(encoding="utf-8")
    assert "BRISTLES" in (tmp_path / "fixed_effects.py").read_text(encoding="utf-8")


def test_the_companion_bends_its_bristles_from_call_to_call() -> None:
    values = with_shared_values({
        "coulomb_friction.level": 0.5, "stribeck_friction.level": 0.2, "stribeck_friction.velocity": 0.1,
        "static_friction.level": 0.3, "presliding_friction.length": LENGTH,
        "presliding_friction.time_constant": TIME_CONSTANT,
    })  # fmt: skip
    assert values["coulomb_friction.level"] == 0.0, "the file's own would hold"
    names: dict[str, object] = {}
    text = companion_text(sort_effects(values), "new.xml", Usage.in_mujoco("torque"), 1e-4)
    exec(text, names)
    force, bristles = names["force"], names["BRISTLES"]
    assert force(0.0, 0.0) == 0.0  # type: ignore[operator]
    force(0.01, 0.05)  # type: ignore[operator]
    there = 1.0 - np.exp(-0.01 / LENGTH)
    assert bristles.bend == pytest.approx(there)  # type: ignore[attr-defined]
    back = (1.0 + there) * np.exp(-0.001 / LENGTH) - 1.0
    share = back + TIME_CONSTANT * (-0.05 - 0.05 * back) / LENGTH
    expected = -0.7 * share + 0.2 * (1.0 - np.exp(-0.05 / 0.1)) * back
    assert force(0.009, -0.05) == pytest.approx(expected)  # type: ignore[operator]
