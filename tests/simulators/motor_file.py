"""The motor of the examples: its MuJoCo file, and that file as a rig."""

from __future__ import annotations

import sys
from pathlib import Path

import labhil as lh
from labhil.simulators.simulator import Simulator

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "motor"))
from motor_bench import FILE as EXAMPLE
from motor_bench import with_motor

FILE = EXAMPLE.read_text(encoding="utf-8")


def rig_of(path: Path) -> Simulator:
    """The file as a rig."""
    rig = lh.mujoco_simulator(path, inputs={"voltage": "motor"}, outputs={"angle": "shaft"})
    assert isinstance(rig, Simulator)
    return rig


__all__ = ["FILE", "rig_of", "with_motor"]
