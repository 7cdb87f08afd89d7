"""The benchmark's arm: a UR5 with known links and torque constants, its friction to be estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labhil.experiment.excitation import evaluate_motion, fourier
from labhil.kinds import JOINTS
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.plants.arm import ArmPlant
from labhil.plants.arm.effects import BARE_ARM, EFFECTS, Overrides
from labhil.rig import parse_rig
from labhil.signals import FloatArray
from labhil_benchmarks.statistics.noise import noise_like
from labhil_benchmarks.statistics.trial import Simulated

PERIOD = 0.008
DURATION = 20.0
TERMS = ("viscous_friction", "coulomb_friction", "sensor_offset")
ABSENT = ("quadratic_viscous_friction", "load_dependent_friction", "friction_asymmetry")
CONSTANTS = np.array(BARE_ARM["torque_constant"])
NOISE = np.array(BARE_ARM["current_noise"])
RIG = f'[rig]\nkind = "ur5"\n[known]\ntorque_constant = {CONSTANTS.tolist()}\n'
SILENT = {"q_noise": 0.0, "qd_noise": 0.0, "current_noise": 0.0, "current_resolution": 0.0}
CENTRE = np.array([0.0, -1.57, 1.0, -1.0, -1.57, 0.0])
REACH = np.array([2.0, 1.0, 1.2, 1.5, 1.5, 2.0])
SPEED = (1.2, 0.9, 1.2, 1.6, 1.6, 1.8)
ACCELERATION = (3.0, 2.0, 3.0, 5.0, 5.0, 5.0)


def _truth() -> Mapping[str, float]:
    names = {"viscous_friction": "coefficient", "coulomb_friction": "level", "sensor_offset": "offset"}
    return {
        f"{term}.{short}[{joint}]": float(np.broadcast_to(EFFECTS[term].strengths[short], JOINTS)[joint])
        for term, short in names.items()
        for joint in range(JOINTS)
    }


TRUTH = _truth()


def arm(seed: int, coloured: bool) -> Simulated:
    """Twenty seconds of a Fourier trajectory at 125 Hz, noise on the currents, and another to test on."""
    random = np.random.default_rng([seed, coloured])
    clean, test = (follow(TERMS, SILENT, 2 * seed + i) for i in (0, 1))
    added = [noise(len(each.t), coloured, random) for each in (clean, test)]
    noisy, tested = (
        replace(each, outputs=each.outputs + own) for each, own in zip((clean, test), added, strict=True)
    )
    # a model of an arm filters its records: what is left of the noise there is what bounds errors
    model = model_for(parse_rig(RIG, Path("ur5.toml")), noisy)
    left = model.prepare(noisy).outputs - model.prepare(clean).outputs
    return Simulated(noisy, tested, np.asarray(left.std(axis=0)))


def follow(terms: Sequence[str], values: Overrides, seed: int) -> Record:
    """What an arm of these effects and values reports of a Fourier trajectory of its own."""
    plant = ArmPlant(values, terms, seed, PERIOD)
    series = fourier(
        tuple(CENTRE - REACH), tuple(CENTRE + REACH), SPEED, ACCELERATION, 0.05, DURATION,
        harmonics=7, centre=tuple(CENTRE), seed=seed,
    )  # fmt: skip
    t: FloatArray = PERIOD * np.arange(round(DURATION / PERIOD), dtype=np.float64)
    seen = plant.follow(*evaluate_motion(series, t))
    per_joint = range(JOINTS)
    return Record(
        t=seen.t,
        inputs=np.ascontiguousarray(np.hstack([seen.actual_q, seen.actual_qd])),
        outputs=np.ascontiguousarray(seen.actual_current),
        input_names=tuple(f"{name}_{j}" for name in ("actual_q", "actual_qd") for j in per_joint),
        output_names=tuple(f"actual_current_{j}" for j in per_joint),
        output_units=("A",) * JOINTS,
        output_joints=tuple(per_joint),
    )


def noise(n: int, coloured: bool, random: np.random.Generator) -> FloatArray:
    """Noise of the six currents (n, 6) A."""
    return np.column_stack([noise_like(n, float(sigma), coloured, random) for sigma in NOISE])
