"""A motor bench with cogging and bristle (LuGre) friction, neither of which is in ``motor.xml``.

``python examples/motor/motor_bench.py FOLDER`` writes FOLDER/run.csv (20 s of the bench, with the columns
t in s, voltage in V and angle in rad) and a copy of motor.xml. MuJoCo simulates the bench in steps of 0.2 ms.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import mujoco
import numpy as np

FILE = Path(__file__).with_name("motor.xml")
HIDDEN = 'cogging="0.0006 12 0.4" lugre="30 0.001 0.0006 0.0006 0.5"'
"""Cogging: amplitude (N·m), poles, phase (rad). LuGre: stiffness (N·m/rad), damping (N·m·s/rad), sliding and
static friction (N·m), Stribeck velocity (rad/s)."""

PERIOD, STEP, NOISE = 0.005, 2e-4, 1e-3  # s, s, rad


def with_motor(attributes: str) -> str:
    """Return the text of the file with further attributes of its motor."""
    return FILE.read_text(encoding="utf-8").replace("<dcmotor ", f"<dcmotor {attributes} ")


def record(
    attributes: str = HIDDEN, seed: int = 1, duration: float = 20.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run a bench whose motor has further attributes.

    Args:
        attributes: The attributes of the ``dcmotor`` that the file does not have.
        seed: Number that decides about voltage and noise.
        duration: Duration, s.

    Returns:
        Times in s, voltages in V and measured angles in rad.
    """
    random = np.random.default_rng(seed)
    t = np.arange(0.0, duration, PERIOD)
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
        for _ in range(round(PERIOD / STEP)):
            mujoco.mj_step(model, data)
    return t, voltage, angle + NOISE * random.standard_normal(len(t))


def main(folder: Path) -> None:
    """Write the recording as a table, and the file beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savetxt(
        folder / "run.csv", np.column_stack(record()), "%.9g", ",", header="t,voltage,angle", comments=""
    )
    if (folder / FILE.name).resolve() != FILE:
        shutil.copy(FILE, folder)
    print(f"{folder / 'run.csv'}: 20 s of the bench")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
