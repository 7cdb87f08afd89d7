"""Windows on several cores: the same to the last bit as one after another, busy cores or not."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labhil.physics import at_once
from labhil.physics.model import Model, Record, Windows, start_values
from labhil.physics.rigs import model_for
from labhil.rig import default_rig

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay, staircase, two_tones

RIGS = {
    "dc_motor": (staircase(10.0, 0.01, 0.4, 5.0, 1), "inertia = 0.1\n", 0.01),
    "axis": (staircase(2.0, 1e-3, 0.1, 80.0, 1), "moving_mass = 95.0\n", 1e-3),
    "solenoid": (two_tones(1.2), "stop_low = 0.0\nstop_high = 0.005\n", 1e-3),
}
DRY = ("viscous_friction", "coulomb_friction", "stribeck_friction")


@pytest.fixture
def three_cores(monkeypatch):
    """Three cores, each worth having for a single row."""
    monkeypatch.setattr(at_once, "cores", lambda: 3)
    monkeypatch.setattr(at_once, "WORTH_A_CORE", 1)
    at_once._helpers.cache_clear()
    yield
    at_once._helpers().shutdown()
    at_once._helpers.cache_clear()


def rolling_ball() -> tuple[Model, Record, np.ndarray, np.ndarray]:
    t = 0.01 * np.arange(1000)
    beam = 0.1 * np.sin(2.0 * np.pi * 0.31 * t)
    record = Record(t, beam[:, None], np.zeros((t.size, 1)), ("beam_angle",), ("ball_position",), ("m",))
    model = model_for(default_rig("ball_beam"), record)
    states = np.random.default_rng(3).normal(0.0, 0.05, (t.size, 2))
    return model, record, start_values(model.parameters), states


def driven(kind: str) -> tuple[Model, Record, np.ndarray, np.ndarray]:
    if kind == "ball_beam":
        return rolling_ball()
    u, known, period = RIGS[kind]
    made = replay(kind, u, DRY, known=known, period=period)
    return made.model, made.record, made.theta, made.states


@pytest.mark.parametrize("kind", [*RIGS, "ball_beam"])
def test_several_cores_simulate_the_same_to_the_last_bit(kind, monkeypatch, three_cores):
    model, record, theta, states = driven(kind)
    n = len(record)
    windows = Windows.of([(0, n // 5), (n // 5, n // 4), (n // 4, n - 7), (n - 7, n - 1)])
    several = model.simulate(theta, record, windows, states[windows.first])
    monkeypatch.setattr(at_once, "cores", lambda: 1)
    one = model.simulate(theta, record, windows, states[windows.first])
    assert np.isfinite(one).all()
    assert np.array_equal(several, one)


@given(st.lists(st.integers(1, 50), max_size=40), st.integers(1, 7))
def test_parts_are_all_windows_once_in_their_order(lengths, count):
    ends = np.cumsum(lengths).astype(int).tolist()
    windows = Windows.of(list(zip([0, *ends], ends, strict=False)))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(at_once, "cores", lambda: count)
        patched.setattr(at_once, "WORTH_A_CORE", 10)
        parts = at_once._parts(windows)
    assert len(parts) <= count
    assert np.array_equal(np.concatenate([windows.first[chosen] for chosen, _ in parts]), windows.first)
    assert np.array_equal(np.concatenate([windows.rows[rows] for _, rows in parts]), windows.rows)
    for chosen, rows in parts:
        assert (windows.last - windows.first)[chosen].sum() == len(windows.rows[rows])


def counted(windows: Windows) -> np.ndarray:
    """How often a kernel was given each row."""
    out = np.zeros((len(windows.rows), 1))

    def kernel(first, last, states, rows):
        assert (last - first).sum() == len(rows)
        rows += 1.0

    at_once.at_once(kernel, windows, np.zeros((len(windows), 1)), out)
    return out


def test_who_calls_does_what_busy_cores_have_not_begun(three_cores):
    windows = Windows.of([(10 * k, 10 * (k + 1)) for k in range(9)])
    free = threading.Event()
    for _ in range(2):
        at_once._helpers().submit(free.wait)
    try:
        assert (counted(windows) == 1.0).all()
    finally:
        free.set()


def test_an_error_of_a_part_is_not_lost(three_cores):
    windows = Windows.of([(10 * k, 10 * (k + 1)) for k in range(9)])

    def kernel(first, last, states, rows):
        if first[0] > 0:
            raise ArithmeticError("expected")

    with pytest.raises(ArithmeticError, match="expected"):
        at_once.at_once(kernel, windows, np.zeros((9, 1)), np.zeros((90, 1)))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
@pytest.mark.filterwarnings("ignore:This process")
def test_a_forked_process_has_threads_of_its_own(three_cores):
    windows = Windows.of([(10 * k, 10 * (k + 1)) for k in range(9)])
    assert (counted(windows) == 1.0).all()
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert (pool.apply_async(counted, (windows,)).get(timeout=30.0) == 1.0).all()
