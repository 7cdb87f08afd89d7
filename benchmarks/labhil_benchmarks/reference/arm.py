"""The UR5 (the text's 5.4): friction of six joints, the links being known."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from labhil.experiment.excitation import evaluate_motion, fourier
from labhil.kinds import JOINTS
from labhil.physics.record import Record
from labhil.plants.arm import ArmPlant
from labhil.signals import FloatArray
from labhil_benchmarks.reference import published
from labhil_benchmarks.reference.levels import Levels
from labhil_benchmarks.reference.study import Data, Study, Swarm

PERIOD = 0.01
DURATION = 60.0
BASE = 1.0 / 20.0
HARMONICS = 7
REACH = (2.0, 1.0, 1.2, 1.5, 1.5, 2.0)
CENTRE = (0.0, -1.57, 1.0, -1.0, -1.57, 0.0)
SPEED = (1.2, 0.9, 1.2, 1.6, 1.6, 1.8)
ACCELERATION = (3.0, 2.0, 3.0, 5.0, 5.0, 5.0)
TORQUE_CONSTANT = (13.26, 11.13, 10.62, 11.03, 11.47, 11.61)
TERMS = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "quadratic_viscous_friction",
    "cubic_viscous_friction",
)
MADE = ("viscous_friction", "coulomb_friction", "stribeck_friction")
SETUP = (
    "Joint angles, velocities and currents at 100 Hz; links by Tables 4.1 and 4.2 and eq. 4.54 to 4.59, "
    "known, as in the text; its plant is one with the values of the table's PSO column, without bristles, "
    "τ_v2 and τ_v3 set to zero as the text finds them. Ours, since the text is silent: Fourier "
    f"trajectories of {HARMONICS} harmonics of {BASE:g} Hz, {DURATION:g} s, another draw to test on; torque "
    "constants, known; noise of the plant's sensors. Both sides of the regression are filtered and thinned "
    "out as `labhil fit` does, where the text differentiates velocities."
)


def simulate(truth: Mapping[str, float], seed: int) -> Data:
    """A recording and a test of the arm with these parameters."""
    record, test = (_run(truth, 2 * seed + i) for i in (0, 1))
    return Data(record, test, np.ones(JOINTS), np.empty(0))


def _run(truth: Mapping[str, float], seed: int) -> Record:
    made = {key: value for key, value in truth.items() if key.partition(".")[0] in MADE}
    plant = ArmPlant({**made, "torque_constant": TORQUE_CONSTANT}, MADE, seed, PERIOD)
    low = tuple(c - r for c, r in zip(CENTRE, REACH, strict=True))
    high = tuple(c + r for c, r in zip(CENTRE, REACH, strict=True))
    series = fourier(
        low, high, SPEED, ACCELERATION, BASE, DURATION, harmonics=HARMONICS, centre=CENTRE, seed=seed
    )
    t: FloatArray = PERIOD * np.arange(round(DURATION / PERIOD), dtype=np.float64)
    seen = plant.follow(*evaluate_motion(series, t))
    return _record(seen.t, seen.actual_q, seen.actual_qd, seen.actual_current)


def _record(t: FloatArray, q: FloatArray, qd: FloatArray, current: FloatArray) -> Record:
    six = range(JOINTS)
    return Record(
        t=t,
        inputs=np.ascontiguousarray(np.hstack([q, qd])),
        outputs=np.ascontiguousarray(current),
        input_names=tuple(f"{name}_{j}" for name in ("actual_q", "actual_qd") for j in six),
        output_names=tuple(f"actual_current_{j}" for j in six),
        output_units=("A",) * JOINTS,
        output_joints=tuple(six),
    )


TRUTH = tuple(0.0 if row.symbol in {"τ_v2", "τ_v3"} else row.pso for row in published.TABLE_5_14.rows)
VISCOUS_OF_JOINT = {row.joint: row.pso for row in published.TABLE_5_14.rows if row.symbol == "τ_v1"}

ARM = Study(
    name="arm",
    variant="",
    parameters=published.TABLE_5_14,
    quality=published.TABLE_5_15,
    rig=f'[rig]\nkind = "ur5"\n[known]\ntorque_constant = {list(TORQUE_CONSTANT)}\n',
    terms=TERMS,
    truth=TRUTH,
    sizes=tuple(VISCOUS_OF_JOINT[row.joint] for row in published.TABLE_5_14.rows),
    swarm=Swarm(60, 1000, "not stated; 10 particles for each of a joint's six parameters, as in Table 5.2"),
    setup=SETUP,
    torque_constant=TORQUE_CONSTANT,
    simulate=partial(simulate, Levels(published.TABLE_5_14.rows).to_ours(TRUTH)),
)
