"""Recordings made by the plant, which shares no code with the model that is fitted to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.record import Record
from labhil.plants.ball_beam import BallBeamPlant
from labhil.rig import parse_rig

Acquire = Callable[..., Record]

KNOWN = "[known]\nball_mass = 0.261\nball_radius = 0.02\ncrank_radius = 0.08\nbeam_length = 0.40\n"


@pytest.fixture(scope="session")
def model() -> BallBeamModel:
    return BallBeamModel(parse_rig('[rig]\nkind = "ball_beam"\n' + KNOWN, Path("rig.toml")))


@pytest.fixture(scope="session")
def acquire() -> Acquire:
    return closed_loop


def closed_loop(
    terms: Sequence[str],
    seed: int,
    *,
    parameters: Mapping[str, float] | None = None,
    frequencies: Sequence[float] = (0.23, 0.31),
    amplitude: float = 0.6,
    duration: float = 60.0,
) -> Record:
    """Two sines with the stabilising controller, sample by sample, as the runner and the twin do it."""
    plant = BallBeamPlant(parameters, terms, seed)
    n = round(duration / plant.period)
    t = plant.period * np.arange(n)
    excitation = amplitude * np.sin(2 * np.pi * np.outer(t, frequencies)).sum(axis=1)
    u, y, slope = np.zeros(n), np.zeros(n), 0.0
    y[0] = plant.sensor.position(np.array([plant.count()]))[0]
    forget = np.exp(-plant.period / 0.03)
    for i in range(1, n):
        wanted = excitation[i - 1] - 7.0 * y[i - 1] - 3.0 * slope
        u[i] = np.clip(wanted, max(u[i - 1] - 0.12, -1.2), min(u[i - 1] + 0.12, 1.2))
        y[i] = plant.sensor.position(np.array([plant.step(u[i])]))[0]
        slope = forget * slope + (1.0 - forget) * (y[i] - y[i - 1]) / plant.period
    return Record(t, u[:, None], y[:, None], ("servo_angle",), ("ball_position",), ("m",))
