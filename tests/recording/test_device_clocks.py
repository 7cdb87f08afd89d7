"""Two devices with clocks of their own: how well they are aligned, and whether the error is honest."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.recording.device_clocks import (
    MAX_STAMPS,
    StampCollector,
    clocks_from_metadata,
    clocks_to_metadata,
    pairwise_offsets,
)

START_NS = 1_790_000_000_000_000_000


def stamps(rng, drift, phase, seconds=60.0, rate=100.0, late=0.03):
    """Return (t_acq_ns, t_hw_ns): 1 ms of latency, 0.5 ms of jitter, at times 20 ms of a busy machine."""
    true = np.arange(int(seconds * rate)) / rate
    delay = 0.001 + rng.gamma(2.0, 0.00035, len(true))
    delay += np.where(rng.random(len(true)) < late, rng.exponential(0.02, len(true)), 0.0)
    acquired = START_NS + np.round((true + delay) * 1e9).astype(np.int64)
    return acquired, np.round((phase + true * (1 + drift)) * 1e9).astype(np.int64)


def watched(*args, **kwargs):
    watch = StampCollector()
    acquired, device = stamps(*args, **kwargs)
    for first in range(0, len(acquired), 7):
        watch.add(acquired[first : first + 7], device[first : first + 7])
    return watch.clock()


def test_two_clocks_200_ppm_apart_are_aligned_within_the_error_that_is_told():
    misses = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        clocks = {"a": watched(rng, 200e-6, 100.0), "b": watched(rng, 0.0, 5.0)}
        found = pairwise_offsets(clocks)["a", "b"]
        elapsed = (found.t_host_ns - START_NS) * 1e-9 - 0.001  # both wires have the same latency
        truth = 95.0 + 200e-6 * elapsed
        assert abs(found.offset - truth) < 1e-4 and found.error < 1e-4
        assert abs(found.offset - truth) < found.bound < 3e-3
        misses.append((found.offset - truth) / found.error)
        assert clocks["a"].drift == pytest.approx(200e-6, abs=6 * clocks["a"].drift_error)
        assert clocks["a"].outliers > 50
    assert np.mean(np.abs(misses) < 2.0) >= 0.9


def test_the_bound_holds_where_a_whole_recording_was_late():
    """What all stamps of one wire share does not scatter: only how late they usually are tells of it."""
    rng = np.random.default_rng(7)
    true = np.arange(6000) / 100.0
    # a queue that is never empty, as of a busy machine
    late = 0.001 + 0.0004 + rng.gamma(2.0, 0.0004, len(true))
    watch = StampCollector()
    watch.add(
        START_NS + np.round((true + late) * 1e9).astype(np.int64),
        np.round((7.0 + true) * 1e9).astype(np.int64),
    )
    clocks = {"late": watch.clock(), "sound": watched(rng, 0.0, 5.0)}
    found = pairwise_offsets(clocks)["late", "sound"]
    assert abs(found.offset - 2.0) > 3 * found.error
    assert abs(found.offset - 2.0) < found.bound
    assert clocks["late"].bound_at(found.t_host_ns) > 2 * clocks["late"].error_at(found.t_host_ns)


def test_a_host_clock_that_was_set_makes_an_offset_as_unsure_as_it_jumped():
    acquired, device = stamps(np.random.default_rng(3), 0.0, 5.0)
    acquired[4000:] -= 500_000_000
    watch, sound = StampCollector(), watched(np.random.default_rng(4), 0.0, 7.0)
    watch.add(acquired, device)
    clock = watch.clock()
    assert clock.stepped == pytest.approx(0.5, abs=0.01)
    assert clock.drift == pytest.approx(0.0, abs=5 * clock.drift_error)
    found = pairwise_offsets({"a": clock, "b": sound})["a", "b"]
    assert found.offset == pytest.approx(-2.0, abs=0.01) and found.error > 0.4


def test_clocks_come_back_from_the_recordings_metadata():
    rng = np.random.default_rng(1)
    clocks = {"a": watched(rng, 50e-6, 0.0), "b": watched(rng, -50e-6, 1.0)}
    tables = clocks_to_metadata(clocks)
    assert set(tables["clock_offsets"]) == {"a - b"}
    assert clocks_from_metadata(tables) == clocks
    assert clocks_from_metadata({"clocks": {"a": "{}", "b": "nonsense"}}) == {}
    assert clocks_to_metadata({}) == {}


def test_a_long_recording_keeps_a_bounded_number_of_stamps():
    clock = watched(np.random.default_rng(2), 50e-6, 0.0, seconds=1000.0)
    assert MAX_STAMPS / 2 <= clock.samples <= MAX_STAMPS
    assert clock.drift == pytest.approx(50e-6, abs=1e-6)


def test_a_clock_that_stands_still_is_none():
    watch = StampCollector()
    watch.add(START_NS + np.arange(100, dtype=np.int64), np.zeros(100, dtype=np.int64))
    assert watch.clock() is None
    assert StampCollector().clock() is None


def test_stamps_that_come_one_by_one_are_kept_as_those_that_come_together():
    t_hw_ns = np.arange(3000, dtype=np.int64) * 10_000_000
    t_acq_ns = t_hw_ns + 1_700_000_000_000_000_000
    together, one_by_one = StampCollector(), StampCollector()
    together.add(t_acq_ns, t_hw_ns)
    for k in range(len(t_hw_ns)):
        one_by_one.add(t_acq_ns[k : k + 1], t_hw_ns[k : k + 1])
    a, b = together.stamps(100.0), one_by_one.stamps(100.0)
    assert np.array_equal(a.t_hw_ns, b.t_hw_ns) and np.array_equal(a.seq, b.seq)
    assert len(one_by_one._arrays) < 1000
