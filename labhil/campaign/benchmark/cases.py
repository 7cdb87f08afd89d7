"""The benchmark's cases: a plant with known parameters and an experiment that a user would make with it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter

from labhil.campaign.benchmark.trial import Case, Simulated
from labhil.physics.model import Record
from labhil.plants.ball_beam import BallBeamPlant
from labhil.signals import FloatArray

COLOUR = 0.7

BALL_BEAM_TRUTH: Mapping[str, float] = {
    "viscous_friction.coefficient": 0.26,
    "coulomb_friction.level": 0.09,
    "stribeck_friction.level": 0.06,
    "stribeck_friction.velocity": 0.02,
}
BALL_BEAM_RIG = """
[rig]
kind = "ball_beam"
[known]
ball_mass = 0.261
ball_radius = 0.02
crank_radius = 0.08
beam_length = 0.40
"""


STEP = 0.5 / 1024
"""Step of the ball-and-beam bench's converter, m: 10 bits over half a metre."""


def held_ball(
    terms: tuple[str, ...], parameters: Mapping[str, float], noise: FloatArray, phase: float
) -> Record:
    """Two sines on a ball and beam with the stabilising controller, sample by sample.

    ``noise`` (n,) m is added before the converter; ``phase`` (rad) sets the second sine.
    """
    plant = BallBeamPlant({**parameters, "position_noise": 0.0}, terms)
    n = len(noise)
    t: FloatArray = plant.period * np.arange(n, dtype=np.float64)
    excitation = 0.6 * (np.sin(2 * np.pi * 0.23 * t) + np.sin(2 * np.pi * 0.31 * t + phase))
    u, y, slope = np.zeros(n), np.zeros(n), 0.0
    y[0] = STEP * np.rint((plant.position + noise[0]) / STEP)
    forget = np.exp(-plant.period / 0.03)
    for i in range(1, n):
        wanted = excitation[i - 1] - 7.0 * y[i - 1] - 3.0 * slope
        u[i] = np.clip(wanted, max(u[i - 1] - 0.12, -1.2), min(u[i - 1] + 0.12, 1.2))
        plant.step(u[i])
        y[i] = STEP * np.rint((plant.position + noise[i]) / STEP)
        slope = forget * slope + (1.0 - forget) * (y[i] - y[i - 1]) / plant.period
    return Record(t, u[:, None], y[:, None], ("servo_angle",), ("ball_position",), ("m",))


def noise_like(n: int, sigma: float, coloured: bool, random: np.random.Generator) -> FloatArray:
    """White noise (n,) of this standard deviation, or coloured: AR(1), neighbours correlated by 0.7."""
    white = random.standard_normal(n)
    if not coloured:
        return np.asarray(sigma * white)
    return np.asarray(sigma * lfilter([np.sqrt(1.0 - COLOUR**2)], [1.0, -COLOUR], white))


def ball_beam(seed: int, coloured: bool) -> Simulated:
    """A minute on a beam with dry friction, and half a minute to test on."""
    random = np.random.default_rng([seed, coloured])
    terms = ("viscous_friction", "coulomb_friction", "stribeck_friction")
    record, test = (
        held_ball(terms, BALL_BEAM_TRUTH, noise_like(n, 4e-4, coloured, random), random.uniform(0.0, 6.28))
        for n in (6000, 3000)
    )
    return Simulated(record, test, np.array([np.hypot(4e-4, STEP / np.sqrt(12.0))]))


CASES: Mapping[str, Case] = {
    case.name: case
    for case in (
        Case(
            "ball_beam",
            BALL_BEAM_RIG,
            ("viscous_friction", "coulomb_friction", "stribeck_friction"),
            ("quadratic_viscous_friction", "constant_force", "time_delay"),
            BALL_BEAM_TRUTH,
            ball_beam,
        ),
    )
}
