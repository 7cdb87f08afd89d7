"""The motor bench of the examples: its MuJoCo file as a rig, and recordings of what the file leaves out."""

from __future__ import annotations

import sys
from pathlib import Path

import labhil as lh
from labhil.simulators.simulator import Simulator

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "motor"))
from motor_bench import FILE as EXAMPLE
from motor_bench import record, with_motor

FILE = EXAMPLE.read_text(encoding="utf-8")


def turned(attributes: str, rig: Simulator, seed: int, *, duration: float = 20.0) -> lh.Recording:
    """A recording of a bench whose motor has further attributes; MuJoCo steps it in 0.2 ms."""
    t, voltage, angle = record(attributes, seed, duration)
    return lh.recording(t, {"voltage": voltage}, {"angle": angle}, rig=rig)


def rig_of(path: Path) -> Simulator:
    """The file as a rig."""
    rig = lh.mujoco_simulator(path, inputs={"voltage": "motor"}, outputs={"angle": "shaft"})
    assert isinstance(rig, Simulator)
    return rig


__all__ = ["FILE", "rig_of", "turned", "with_motor"]
