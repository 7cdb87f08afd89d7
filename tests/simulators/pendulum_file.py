"""A pendulum as a MuJoCo file, and recordings of the independent plant that it is to become."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pendulum_plant import swung, torques

import labhil as lh

FILE = """<?xml version="1.0"?>
<!-- our pendulum: all values from the drawing -->
<mujoco model='rod'>
  <option timestep="0.001"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge"
             axis="0 1 0"/>  <!-- ball bearing, taken for free of friction -->
      <inertial pos="0 0 -0.1" mass="0.4" diaginertia="0.015 0.015 1e-3"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
  <sensor><jointpos name="encoder" joint="hinge"/></sensor>
</mujoco>
"""
"""The plant's inertia is 0.025 kg·m² and its gravity torque 0.45 N·m (with 9.81 m/s²: 0.459 kg at 0.1 m)."""

RIG = """[model]
mujoco = "rod.xml"
inputs = { torque = "motor" }
outputs = { angle = "encoder" }
"""


def bench(folder: Path, file: str = FILE) -> Path:
    """The file and its rig file in a folder; gives the rig file."""
    (folder / "rod.xml").write_text(file, encoding="utf-8")
    (folder / "rig.toml").write_text(RIG, encoding="utf-8")
    return folder / "rig.toml"


def recorded(rig: Path, *, seed: int, seconds: float, dry: float = 0.0, late: int = 0) -> Path:
    """A recording of the plant beside the rig file."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    u = torques(t, random)
    angle = swung(t, u, dry=dry, late=late) + 1e-3 * random.standard_normal(len(t))
    path = rig.parent / "run.mcap"
    lh.recording(t, {"torque": u}, {"angle": angle}, rig=rig).save(path)
    return path
