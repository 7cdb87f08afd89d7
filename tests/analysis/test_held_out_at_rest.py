"""Held-out data at rest show no mismatch, the search data still may; so may a rig that hardly moves."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import rig_of

from labhil.diagnose.diagnosis import diagnose
from labhil.identify.windows import split
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.signals import Hold

PERIOD, MASS, FRICTION = 0.01, 10.0, 40.0


def shoved(seconds: float, seed: int) -> Record:
    """An axis that somebody shoves again and again while it is driven, and leaves alone near the end."""
    random = np.random.default_rng(seed)
    n = round(seconds / PERIOD)
    t, busy = PERIOD * np.arange(n), np.arange(n) < 0.6 * n
    force = busy * (60.0 * np.sin(1.9 * t) + 40.0 * np.sin(5.3 * t))
    shoves = busy * np.repeat(random.uniform(-30.0, 30.0, n // 20 + 1), 20)[:n]
    x, v, decay = np.empty(n), np.empty(n), np.exp(-FRICTION / MASS * PERIOD)
    x[0] = v[0] = 0.0
    for k in range(n - 1):  # exact between samples
        end = (force[k] + shoves[k]) / FRICTION
        v[k + 1] = end + (v[k] - end) * decay
        x[k + 1] = x[k] + end * PERIOD + (v[k] - end) * (1.0 - decay) * MASS / FRICTION
    y = x + 1e-4 * random.standard_normal(n)
    return Record(t, force[:, None], y[:, None], ("drive_force",), ("position",), ("m",), (Hold.ZERO,))


@pytest.mark.extended
@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", [pytest.param(1, marks=pytest.mark.long), 2])
def test_a_mismatch_of_the_search_data_is_kept(seed: int) -> None:
    record = shoved(100.0, seed)
    model = model_for(rig_of("axis"), record)
    learn, judge = split(record, 0.3, model.horizon)
    found = diagnose(model, learn, judge, heldout_is_test=False, baseline=["viscous_friction"])
    assert found.after.excess < 1.5  # what was held out is explained: nothing happens there
    assert found.verdict != "no_mismatch"
    assert found.p_value < 1e-6


def sprung(seconds: float, ratio: float, seed: int, stiffness: float = 900.0) -> Record:
    """An axis on a spring, of which noise leaves little to see: its position varies by ``ratio`` of it."""
    t = PERIOD * np.arange(round(seconds / PERIOD))
    force = 60.0 * np.sin(1.9 * t) + 40.0 * np.sin(5.3 * t)
    _, x, _ = lsim(([1.0], [MASS, 20.0, stiffness]), force, t)
    y = x + np.std(x) / ratio * np.random.default_rng(seed).standard_normal(len(t))
    return Record(t, force[:, None], y[:, None], ("drive_force",), ("position",), ("m",), (Hold.LINEAR,))


@pytest.mark.extended
@pytest.mark.timeout(600)
def test_an_error_beyond_the_noise_is_searched_however_little_the_axis_moves() -> None:
    record = sprung(60.0, ratio=3.0, seed=1)
    model = model_for(rig_of("axis"), record)
    learn, judge = split(record, 0.3, model.horizon)
    found = diagnose(model, learn, judge, heldout_is_test=False, baseline=["viscous_friction"])
    assert [entry.term for entry in found.missing] == ["spring_force"]


def test_an_axis_that_hardly_moves_as_its_model_says_decides_nothing() -> None:
    record = sprung(60.0, ratio=0.5, seed=1, stiffness=0.0)
    model = model_for(rig_of("axis"), record)
    learn, judge = split(record, 0.3, model.horizon)
    found = diagnose(model, learn, judge, heldout_is_test=False, baseline=["viscous_friction"])
    assert found.verdict == "not_decidable"
    assert "times its noise" in found.undecided[0].reason
