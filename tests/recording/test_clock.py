"""The device's clock on the host's: drift, jitter and outliers put in, and taken out again."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labhil.recording.clock import fit_clock

START = 1_700_000_000_000_000_000


def stamps(drift, jitter, share, seed, rate=100.0, seconds=60.0, speed=1.0):
    """Return true host time (s, times speed), device stamps and host stamps (ns)."""
    rng = np.random.default_rng(seed)
    n = int(rate * seconds)
    device = np.arange(n) / rate
    world = device / (1.0 + drift)
    late = rng.exponential(jitter, n)
    struck = rng.random(n) < share
    late[struck] += rng.uniform(0.01, 1.0, np.count_nonzero(struck))
    acquired = START + np.rint((world / speed + late) * 1e9).astype(np.int64)
    return world, 777 + np.rint(device * 1e9).astype(np.int64), acquired


@settings(deadline=None, max_examples=60)
@given(
    drift=st.floats(-200e-6, 200e-6),
    jitter=st.floats(1e-5, 2e-3),
    share=st.floats(0.0, 0.2),
    seed=st.integers(0, 2**32 - 1),
)
def test_drift_and_time_are_found_whatever_the_wire_adds(drift, jitter, share, seed):
    world, t_hw_ns, t_acq_ns = stamps(drift, jitter, share, seed)
    fit = fit_clock(t_hw_ns, t_acq_ns, START)
    assert fit.device_clock
    # a constant latency cannot be told from a later zero; everything else can
    error = fit.t - world
    assert np.ptp(error) < 0.25 * jitter + 1e-6
    assert fit.drift == pytest.approx(drift, abs=0.25 * jitter / 60.0 + 1e-7)
    assert (np.diff(fit.t) > 0).all()


def test_outliers_are_counted():
    _, t_hw_ns, t_acq_ns = stamps(50e-6, 1e-4, 0.0, 1)
    t_acq_ns[[100, 2000, 5999]] += 300_000_000
    assert fit_clock(t_hw_ns, t_acq_ns, START).outliers >= 3


def test_a_faster_world_runs_in_its_own_seconds():
    world, t_hw_ns, t_acq_ns = stamps(100e-6, 1e-4, 0.01, 2, speed=10.0)
    fit = fit_clock(t_hw_ns, t_acq_ns, START, speed=10.0)
    assert np.ptp(fit.t - world) < 1e-3
    assert fit.drift == pytest.approx(100e-6, abs=1e-5)


def test_equal_clocks_give_the_times_themselves():
    t = np.rint(np.arange(600) * 1e8).astype(np.int64)
    fit = fit_clock(t, t, 0)
    assert np.array_equal(fit.t, t * 1e-9)
    assert (fit.drift, fit.outliers) == (0.0, 0)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_samples_keep_the_hosts_time(n):
    t_acq_ns = START + np.arange(n, dtype=np.int64) * 1_000_000_000
    fit = fit_clock(np.arange(n, dtype=np.int64), t_acq_ns, START)
    assert fit.t.tolist() == list(range(n))
    assert not fit.device_clock


def test_a_device_clock_that_stands_still_is_not_used():
    t_acq_ns = START + np.arange(100, dtype=np.int64) * 10_000_000
    fit = fit_clock(np.zeros(100, dtype=np.int64), t_acq_ns, START)
    assert not fit.device_clock
    assert fit.t == pytest.approx(np.arange(100) / 100)


def test_a_clock_of_another_world_is_not_used():
    """Twice as fast and no speed given: that is no drift."""
    world, t_hw_ns, t_acq_ns = stamps(0.0, 1e-4, 0.0, 3, speed=2.0)
    fit = fit_clock(t_hw_ns, t_acq_ns, START)
    assert not fit.device_clock
    assert fit.t[-1] == pytest.approx(world[-1] / 2, abs=0.01)


def test_a_world_that_paused_keeps_its_own_time():
    """A simulated device on a busy machine: now and then nothing happens in it for a while."""
    world = np.delete(np.arange(2000), [77, 78, 1500]) * 0.01
    host = world + 0.08 * np.floor(world / 1.7)
    fit = fit_clock((world * 1e9).astype(np.int64), START + (host * 1e9).astype(np.int64), START)
    assert fit.device_clock
    np.testing.assert_allclose(np.diff(fit.t), np.diff(world), atol=1e-9)


def test_a_short_recording_keeps_the_devices_steps():
    _, t_hw_ns, t_acq_ns = stamps(0.0, 2e-3, 0.1, 4, seconds=0.5)
    fit = fit_clock(t_hw_ns, t_acq_ns, START)
    assert np.diff(fit.t) == pytest.approx(0.01)
