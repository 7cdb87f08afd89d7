"""An arm of three hinges as MJCF and as URDF, and recordings of a real one that differs from it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import labhil as lh

JOINTS = 3
RATE = 125.0

MJCF = """<mujoco model="reach">
  <worldbody>
    <body name="turret" pos="0 0 0.2">
      <joint name="turn" axis="0 0 1" damping="1"/>
      <inertial mass="3" pos="0 0.01 0.05" diaginertia="0.02 0.02 0.01"/>
      <body name="upper" pos="0 0.1 0" euler="0 20 0">
        <joint name="lift" axis="0 1 0"/>
        <inertial mass="4" pos="0.2 0 0.02" quat="1 0.1 0 0" diaginertia="0.02 0.06 0.05"/>
        <body name="lower" pos="0.4 0 0">
          <joint name="bend" axis="0 1 0" pos="0.01 0 0"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1.5"/>
          <body name="tool" pos="0.3 0 0"><geom type="sphere" size="0.03" mass="0.4"/></body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

URDF = """<?xml version="1.0"?>
<robot name="reach">
  <link name="base"/>
  <link name="turret">
    <inertial><origin xyz="0 0.01 0.05"/><mass value="3"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial>
  </link>
  <link name="upper">
    <inertial><origin xyz="0.2 0 0.02" rpy="0.1 0 0"/><mass value="4"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.05"/></inertial>
  </link>
  <link name="lower">
    <inertial><origin xyz="0.15 0 0"/><mass value="1.5"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial>
  </link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="turret"/>
    <origin xyz="0 0 0.2"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="50" velocity="5"/>
    <dynamics damping="1"/></joint>
  <joint name="lift" type="revolute"><parent link="turret"/><child link="upper"/>
    <origin xyz="0 0.1 0" rpy="0 0.35 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="50" velocity="5"/></joint>
  <joint name="bend" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="5"/></joint>
  <link name="tool">
    <inertial><origin xyz="0 0.01 0" rpy="0 0 0.5"/><mass value="0.4"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial>
  </link>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="0.3 0 0"/></joint>
</robot>
"""

DAMPING = (2.5, 1.5, 0.8)
DRY = (1.2, 1.6, 0.9)
ROTOR = (0.4, 0.5, 0.2)
LOAD_SHARE = 0.12
NOISE = 0.05
RIG = """[model]
mujoco = "{file}"
outputs = {{ joint_torque = "torque" }}
"""


def bench(folder: Path, text: str = MJCF, name: str = "reach.xml") -> Path:
    """Write a file and its rig file; the rig file's path."""
    (folder / name).write_text(text, encoding="utf-8")
    rig = folder / "rig.toml"
    rig.write_text(RIG.format(file=name), encoding="utf-8")
    return rig


def motion(seed: int, seconds: float) -> tuple[np.ndarray, ...]:
    """Times (n,), angles, velocities, accelerations (n, 3) of Fourier series."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    w = 2.0 * np.pi * np.arange(1, 9) / 15.0
    a, b = random.normal(size=(2, JOINTS, len(w))) * 0.45 / np.sqrt(np.arange(1, 9))
    s, c = np.sin(w[:, None] * t), np.cos(w[:, None] * t)
    q = (a @ s + b @ c).T
    qd = ((a * w) @ c - (b * w) @ s).T
    qdd = (-(a * w**2) @ s - (b * w**2) @ c).T
    return t, q, qd, qdd


def truth(folder: Path, text: str = MJCF, *, heavier: float = 1.0) -> mujoco.MjModel:
    """The real arm's bodies: those of the file, the last one heavier; no friction."""
    path = folder / ("truth.urdf" if text is URDF else "truth.xml")
    path.write_text(text, encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(path))
    last = int(model.jnt_bodyid[JOINTS - 1])
    model.body_mass[last] *= heavier
    model.body_inertia[last] *= heavier
    model.dof_damping[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT)
    return model


def torques(model: mujoco.MjModel, *along: np.ndarray) -> np.ndarray:
    """MuJoCo's inverse dynamics (n, 3)."""
    data, out = mujoco.MjData(model), np.empty_like(along[0])
    for row, (q, qd, qdd) in enumerate(zip(*along, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        out[row] = data.qfrc_inverse
    return out


def recorded(
    folder: Path,
    rig: Path,
    text: str = MJCF,
    *,
    seed: int = 1,
    seconds: float = 30.0,
    heavier: float = 1.0,
    signs: tuple[float, ...] = (1.0, 1.0, 1.0),
    noise: float = NOISE,
) -> Path:
    """A recording of the real arm: heavier, with rotors, damping, dry friction that grows with the load."""
    t, q, qd, qdd = motion(seed, seconds)
    links = torques(truth(folder, text, heavier=heavier), q, qd, qdd)
    tau = links + qdd * ROTOR + qd * DAMPING + np.sign(qd) * DRY
    tau[:, 1] += LOAD_SHARE * np.abs(links[:, 1]) * np.sign(qd[:, 1])
    tau = tau * signs + np.random.default_rng(seed).normal(size=tau.shape) * noise
    recording = lh.recording(t, {"actual_q": q, "actual_qd": qd}, {"joint_torque": tau}, rig=rig)
    path = folder / f"run_{seed}.mcap"
    recording.save(path)
    return path
