"""The device's clock is the time of analysis; the map onto the host's finds drift, jitter, outliers and
steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labhil.link import Unwrapper
from labhil.recording.clock import fit_clock, keeps_declared_rate
from labhil.recording.clock_faults import ClockFaultKind, find_clock_faults
from labhil.recording.clock_map import fit_delay_line
from labhil.recording.stamps import Stamps

START = 1_700_000_000_000_000_000
RATE = 100.0


def busy(rng, world, per_second, longest):
    """Delays of a host that now and then takes no samples for a while, and then all at once; s."""
    late = 1e-3 + rng.exponential(2e-4, len(world))
    count = rng.poisson(per_second * world[-1])
    stalls = zip(rng.uniform(0.0, world[-1], count), rng.exponential(longest, count), strict=True)
    for begin, length in stalls:
        held = (world >= begin) & (world < begin + length)
        late[held] = np.maximum(late[held], begin + length - world[held])
    return late


def stamps(drift, jitter, share, seed, rate=RATE, seconds=60.0, speed=1.0):
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


def own(t_hw_ns):
    return (t_hw_ns - t_hw_ns[0]) * 1e-9


def found_in(t_hw_ns, t_acq_ns, *, seq=None, speed=1.0, rate=RATE, **known):
    """Return the fit of a stream's clock, and what is wrong with it."""
    seq = np.arange(len(t_hw_ns)) if seq is None else seq
    steady = keeps_declared_rate(t_hw_ns, seq, rate)
    fit = fit_clock(t_hw_ns, t_acq_ns, int(t_acq_ns[0]), speed, steady)
    return fit, find_clock_faults(Stamps(seq, t_hw_ns, t_acq_ns, rate, speed, **known), fit, fit.t - fit.t[0])


@settings(deadline=None, max_examples=40)
@given(
    drift=st.floats(-200e-6, 200e-6),
    jitter=st.floats(1e-5, 2e-3),
    share=st.floats(0.0, 0.2),
    seed=st.integers(0, 2**32 - 1),
)
def test_time_is_the_devices_and_its_drift_is_found_whatever_the_wire_adds(drift, jitter, share, seed):
    world, t_hw_ns, t_acq_ns = stamps(drift, jitter, share, seed)
    fit = fit_clock(t_hw_ns, t_acq_ns, START)
    assert fit.device_clock and not fit.steps
    assert np.ptp(fit.t - own(t_hw_ns)) < 1e-9
    assert fit.drift == pytest.approx(drift, abs=0.25 * jitter / 60.0 + 1e-7)
    # a constant latency cannot be told from a later zero; everything else can
    common = fit.map.steady_host(fit.map.elapsed(t_hw_ns))
    assert np.ptp(common - world) < 0.25 * jitter + 1e-5


@pytest.mark.extended
@settings(deadline=None, max_examples=25)
@given(
    drift=st.floats(-200e-6, 200e-6),
    step=st.sampled_from([-3600.0, -0.5, -0.1, 0.1, 0.5, 3600.0]),
    at=st.floats(0.15, 0.85),
    speed=st.sampled_from([0.5, 1.0, 5.0]),
    seconds=st.sampled_from([15.0, 60.0]),
    lost=st.floats(0.0, 0.1),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_clock_that_is_set_stretches_nothing_and_is_named(drift, step, at, speed, seconds, lost, seed):
    rng = np.random.default_rng(seed)
    seq = np.flatnonzero(rng.random(int(seconds * speed * RATE)) >= lost)
    world = seq / RATE / (1.0 + drift) / speed
    host = world + busy(rng, world, 0.5, 0.02)
    host[host > at * seconds] += step
    t_hw_ns = 5 + np.rint(seq / RATE * 1e9).astype(np.int64)
    fit, faults = found_in(t_hw_ns, START + np.rint(host * 1e9).astype(np.int64), seq=seq, speed=speed)
    assert np.diff(fit.t) == pytest.approx(np.diff(seq) / RATE, abs=1e-9)
    assert [size for each in fit.steps for size in [each.size]] == pytest.approx([step], abs=0.01)
    (fault,) = faults
    assert fault.kind is ClockFaultKind.STEP and not fault.distorts_time
    assert fault.times[0] == pytest.approx(at * seconds * speed, abs=0.2 * speed)
    assert fit.drift == pytest.approx(drift, abs=5.0 * fit.drift_error)


@settings(deadline=None, max_examples=25)
@given(
    drift=st.floats(-200e-6, 200e-6),
    per_second=st.floats(0.0, 4.0),
    longest=st.floats(0.001, 0.08),
    speed=st.sampled_from([1.0, 4.0]),
    seconds=st.sampled_from([5.0, 30.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_busy_machine_is_no_fault_of_the_clock(drift, per_second, longest, speed, seconds, seed):
    rng = np.random.default_rng(seed)
    device = np.arange(int(seconds * speed * RATE)) / RATE
    world = device / (1.0 + drift) / speed
    host = world + busy(rng, world, per_second, longest)
    t_hw_ns = np.rint(device * 1e9).astype(np.int64)
    fit, faults = found_in(t_hw_ns, START + np.rint(host * 1e9).astype(np.int64), speed=speed)
    assert faults == ()
    assert np.ptp(fit.t - own(t_hw_ns)) < 1e-9
    assert fit.drift == pytest.approx(drift, abs=5.0 * fit.drift_error)


def scenarios(rng, x):
    """Delays of one kind of trouble each, with the same least delay of 1 ms; s."""
    frames = np.cumsum(rng.uniform(0.004, 0.04, int(x[-1] / 0.01) + 9))
    yield "jitter", 1e-3 + rng.exponential(5e-4, len(x))
    yield "stalls", busy(rng, x, 1.0, 0.02)
    yield "load", busy(rng, x, 6.0, 0.06)
    yield "bursts", 1e-3 + frames[np.searchsorted(frames, x)] - x
    yield "half", 1e-3 + rng.exponential(np.where(x < 0.5 * x[-1], 5e-3, 3e-4))


@pytest.mark.parametrize("seconds", [5.0, 40.0])
def test_stated_errors_cover_whatever_delays_the_stamps(seconds):
    x = np.arange(int(seconds * RATE)) / RATE
    misses: dict[str, list[tuple[float, float]]] = {}
    for seed in range(25):
        for name, delay in scenarios(np.random.default_rng(seed), x):
            line = fit_delay_line(x, delay - 150e-6 * x)
            level = line.level + 150e-6 * line.middle
            slope = (line.slope + 150e-6) / line.slope_error
            misses.setdefault(name, []).append((level, line.level_error, slope))
    for name, found in misses.items():
        level, error, slope = np.array(found).T
        # what all draws have in common is latency; the rest is what the error is about
        assert np.mean(np.abs(level - np.median(level)) < 2.0 * error) >= 0.9, name
        assert np.mean(np.abs(slope) < 2.0) >= 0.9, name
        assert np.median(error) < 1e-3, name


def test_outliers_are_counted():
    _, t_hw_ns, t_acq_ns = stamps(50e-6, 1e-4, 0.0, 1)
    t_acq_ns[[100, 2000, 5999]] += 300_000_000
    assert fit_clock(t_hw_ns, t_acq_ns, START).outliers >= 3


def test_a_faster_world_runs_in_its_own_seconds():
    _, t_hw_ns, t_acq_ns = stamps(100e-6, 1e-4, 0.01, 2, speed=10.0)
    fit = fit_clock(t_hw_ns, t_acq_ns, START, speed=10.0)
    assert np.ptp(fit.t - own(t_hw_ns)) < 1e-9
    assert fit.drift == pytest.approx(100e-6, abs=1e-5)


def test_equal_clocks_give_the_times_themselves():
    t = np.rint(np.arange(600) * 1e8).astype(np.int64)
    fit = fit_clock(t, t, 0)
    assert np.array_equal(fit.t, t * 1e-9)
    assert (fit.drift, fit.outliers, fit.steps) == (0.0, 0, ())


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
    """Twice as fast, and neither a speed given nor a declared rate that it keeps: that is no drift."""
    world, t_hw_ns, t_acq_ns = stamps(0.0, 1e-4, 0.0, 3, speed=2.0)
    fit, faults = found_in(t_hw_ns, t_acq_ns, rate=2.0 * RATE)
    assert not fit.device_clock
    assert fit.t[-1] == pytest.approx(world[-1] / 2, abs=0.01)
    assert faults[0].kind is ClockFaultKind.NO_CLOCK


def test_a_world_that_paused_keeps_its_own_time_and_is_named():
    """A simulated device on a busy machine: now and then nothing happens in it for a while."""
    seq = np.delete(np.arange(2000), [77, 78, 1500])
    world = seq * 0.01
    host = world + 0.08 * np.floor(world / 1.7)
    t_hw_ns = (world * 1e9).astype(np.int64)
    fit, faults = found_in(t_hw_ns, START + (host * 1e9).astype(np.int64), seq=seq)
    assert fit.device_clock
    np.testing.assert_allclose(np.diff(fit.t), np.diff(world), atol=1e-9)
    assert faults and not any(fault.distorts_time for fault in faults)
    assert "stand" in " ".join(fault.statement for fault in faults) or "stood" in faults[0].statement


def test_what_a_short_recording_cannot_tell_is_named_without_a_rate():
    """Five seconds in which a simulated world falls behind by little pauses, as on a machine that is busy."""
    world = np.arange(500) / RATE
    host = world + 0.03 * np.floor(world / 0.5)
    t_hw_ns = np.rint(world * 1e9).astype(np.int64)
    fit, (fault,) = found_in(t_hw_ns, START + (host * 1e9).astype(np.int64))
    assert np.diff(fit.t) == pytest.approx(0.01) and fit.drift == 0.0 and fit.drift_error is None
    assert "falls behind" in fault.statement and not fault.distorts_time


def test_a_resonator_is_named_and_its_time_is_kept():
    _, t_hw_ns, t_acq_ns = stamps(4e-3, 1e-4, 0.0, 5)
    fit, (fault,) = found_in(t_hw_ns, t_acq_ns)
    assert fault.kind is ClockFaultKind.RATE and "+4000" in fault.statement
    assert np.ptp(fit.t - own(t_hw_ns)) < 1e-9


def test_a_wrap_of_the_devices_microseconds_is_no_step():
    true_us = 2**32 - 5_000_000 + np.arange(1500) * 10_000
    clock = Unwrapper(32)
    t_hw_ns = np.array([clock.unwrap(int(t) % 2**32) for t in true_us]) * 1000
    late = busy(np.random.default_rng(6), np.arange(1500) / RATE, 1.0, 0.02)
    fit, faults = found_in(t_hw_ns, START + (true_us - true_us[0]) * 1000 + (late * 1e9).astype(np.int64))
    assert faults == () and np.diff(fit.t) == pytest.approx(0.01)


def test_a_device_clock_that_jumps_against_its_own_count_is_what_is_wrong():
    _, t_hw_ns, t_acq_ns = stamps(0.0, 1e-4, 0.0, 7)
    t_hw_ns[3000:] += 700_000_000
    _, (fault,) = found_in(t_hw_ns, t_acq_ns)
    assert fault.distorts_time and "its own count" in fault.statement and "+0.7" in fault.statement


def test_where_the_host_is_steady_only_the_device_can_have_stood_still():
    _, t_hw_ns, t_acq_ns = stamps(0.0, 1e-4, 0.0, 8)
    t_acq_ns[3000:] += 500_000_000
    assert "clock was set" in found_in(t_hw_ns, t_acq_ns)[1][0].statement
    steady = found_in(t_hw_ns, t_acq_ns, steady_host=True)[1][0].statement
    assert "clock was set" not in steady and "stood still" in steady


def test_a_short_recording_keeps_the_devices_steps():
    _, t_hw_ns, t_acq_ns = stamps(0.0, 2e-3, 0.1, 4, seconds=0.5)
    fit = fit_clock(t_hw_ns, t_acq_ns, START)
    assert np.diff(fit.t) == pytest.approx(0.01)


@pytest.mark.parametrize("step", [-3600.0, -0.5, 0.5, 3600.0])
def test_a_step_of_host_stamps_alone_is_named(step):
    rng = np.random.default_rng(9)
    host = np.arange(1000) / RATE + rng.exponential(1e-3, 1000)
    host[400:] += step
    t_acq_ns = START + (host * 1e9).astype(np.int64)
    fit, faults = found_in(np.zeros(1000, dtype=np.int64), t_acq_ns)
    (fault,) = (each for each in faults if each.kind is ClockFaultKind.STEP)
    assert not fit.device_clock and fault.distorts_time == (step < 0.0)
    assert fault.times[0] == pytest.approx(fit.t[400] - fit.t[0])


def test_host_stamps_alone_that_are_slewed_are_named():
    host = np.arange(6000) / RATE
    host += 0.08 * np.clip(host - 20.0, 0.0, 6.0)  # 8 % for 6 s, as a daemon makes up for half a second
    _, faults = found_in(np.zeros(6000, dtype=np.int64), START + (host * 1e9).astype(np.int64))
    assert [fault.kind for fault in faults] == [ClockFaultKind.RATE]
    _, faults = found_in(np.zeros(6000, dtype=np.int64), START + np.arange(6000) * 10_200_000)
    assert [fault.kind for fault in faults] == [ClockFaultKind.RATE] and "98.039" in faults[0].statement


def test_even_host_stamps_alone_are_no_fault():
    host = np.arange(6000) / RATE + np.random.default_rng(10).exponential(1e-3, 6000)
    assert found_in(np.zeros(6000, dtype=np.int64), START + (host * 1e9).astype(np.int64))[1] == ()


def test_a_table_whose_clock_went_back_is_named_but_not_its_gaps():
    """Rows that were dropped because their times were there already leave a hole of no time."""
    seq = np.delete(np.arange(3000), np.s_[1000:1050])
    t_ns = np.where(seq < 1000, seq, seq - 50) * 10_000_000
    _, (fault,) = found_in(t_ns, t_ns, seq=seq)
    assert fault.distorts_time and "−0.5" in fault.statement
    gap_ns = np.where(seq < 1000, seq, seq + 300) * 10_000_000
    assert found_in(gap_ns, gap_ns, seq=seq)[1] == ()
