"""A user's MJCF file of a motor bench, and a bench that MuJoCo simulates with what the file leaves out."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import labhil as lh
from labhil.simulators.simulator import Simulator

FILE = """<mujoco model="motor_bench">
  <option timestep="0.001"/>
  <worldbody>
    <body name="rotor">
      <joint name="shaft" axis="0 0 1" damping="2e-6" armature="2e-6"/>
      <geom name="disc" type="cylinder" size="0.02 0.004" mass="0.04"/>
    </body>
  </worldbody>
  <actuator>
    <dcmotor name="motor" joint="shaft" motorconst="0.03" resistance="1.5"/>
  </actuator>
</mujoco>
"""
STEP = 2e-4


def with_motor(attributes: str) -> str:
    """The file with further attributes of its motor."""
    return FILE.replace("<dcmotor ", f"<dcmotor {attributes} ")


def turned(attributes: str, rig: Simulator, seed: int, *, duration: float = 20.0) -> lh.Recording:
    """A recording of a bench whose motor has further attributes; MuJoCo steps it in 0.2 ms."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 0.005)
    waves = zip(
        random.uniform(0.03, 0.15, 6), random.uniform(0.1, 2.0, 6), random.uniform(0.0, 6.28, 6), strict=True
    )
    voltage = np.sum([a * np.sin(2.0 * np.pi * f * t + p) for a, f, p in waves], axis=0)
    model = mujoco.MjModel.from_xml_string(with_motor(attributes))
    model.opt.timestep = STEP
    data, angle = mujoco.MjData(model), np.empty(len(t))
    for k, u in enumerate(voltage):
        angle[k] = data.qpos[0]
        data.ctrl[0] = u
        for _ in range(round(0.005 / STEP)):
            mujoco.mj_step(model, data)
    noisy = angle + 1e-3 * random.standard_normal(len(t))
    return lh.recording(t, {"voltage": voltage}, {"angle": noisy}, rig=rig)


def rig_of(path: Path) -> Simulator:
    """The file as a rig."""
    rig = lh.mujoco_simulator(path, inputs={"voltage": "motor"}, outputs={"angle": "shaft"})
    assert isinstance(rig, Simulator)
    return rig
