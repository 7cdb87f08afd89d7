"""Rest, late inputs, wraps, censored readings and commands: which of them are faults of the data."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from labhil.diagnose.hold import detect_hold
from labhil.diagnose.intake import FaultKind, assess_usability, detect_faults, mark_censored, replace_outliers
from labhil.diagnose.lead import detect_lead
from labhil.diagnose.timing import detect_all_faults, detect_late_input, estimate_hold, unchecked_timing_note
from labhil.diagnose.wraps import detect_wraps
from labhil.ending import Deadline
from labhil.identify.problem import Problem
from labhil.identify.quantiser import held_samples, uneven_step
from labhil.identify.windows import fit_windows, noise_of, with_least_noise
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.physics.right_hand_side import RightHandSide
from labhil.physics.rigs import model_for
from labhil.physics.terms import Parameter
from labhil.rig import default_rig
from labhil.signals import Hold
from labhil_benchmarks.statistics.cases import driven, levels

DRY = ("viscous_friction", "coulomb_friction")
CHANNELS = (("speed", "rad/s"), ("current", "A"))


def motor(u, seed=0, decibels=35.0, period=0.01, **values) -> Record:
    random = np.random.default_rng(seed)
    return driven("dc_motor", u, period, values, DRY, decibels, False, random, CHANNELS)[0]


def stepped(seed=0, n=1500, dwell=30) -> np.ndarray:
    return levels(n, dwell, 5.0, np.random.default_rng(seed))


def late(record: Record, samples: int) -> Record:
    inputs = np.concatenate(
        [record.inputs[:1].repeat(samples, axis=0), record.inputs[: len(record) - samples]]
    )
    return replace(record, inputs=inputs)


def counted(even: bool, seed=0) -> Record:
    """A motor that turns one way now and then, its speed as counts of an encoder over the time they took."""
    random = np.random.default_rng(seed)
    t = 0.012 * np.arange(1000)
    turning = np.clip(np.minimum(t - 3.0, 8.0 - t), 0.0, 1.0) * 20.0
    angle = np.cumsum(turning) * 0.012
    step = 2 * np.pi / 320
    periods = 0.012 * (1.0 if even else 1.0 + 0.006 * random.standard_normal(1000))
    speed = np.diff(np.floor(angle / step), prepend=0.0) * step / periods
    u = np.where(turning > 0.0, 9.0, 3.0)
    return Record(t, u[:, None], speed[:, None], ("voltage",), ("speed",), ("rad/s",), (Hold.ZERO,))


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motor_that_stands_still_is_no_fault(even, sign):
    record = counted(even)
    record = replace(record, inputs=sign * record.inputs, outputs=sign * record.outputs)
    assert detect_faults(record) == ()
    assert mark_censored(record).censored is None


def test_a_sensor_that_knows_one_direction_only_is_clipped_at_zero():
    record = motor(stepped())
    outputs = record.outputs.copy()
    outputs[:, 0] = np.maximum(outputs[:, 0], 0.0)
    faults = detect_faults(replace(record, outputs=outputs))
    assert [(fault.kind, fault.channel) for fault in faults] == [(FaultKind.SATURATED, "speed")]


@pytest.mark.parametrize("even", [True, False])
def test_the_noise_of_a_counter_is_that_of_its_moving_part(even):
    record = counted(even)
    step = 2 * np.pi / 320 / 0.012
    if not even:
        assert uneven_step(record.outputs[:, 0]) == pytest.approx(step, rel=0.01)
    # a rate of counts is off by two roundings: step²/6
    assert step / np.sqrt(12.0) <= noise_of(record)[0] < 0.6 * step
    still = with_least_noise(record).part(700, 1000)
    assert np.ptp(still.outputs) == 0.0
    assert step / np.sqrt(12.0) <= noise_of(still)[0] * (1.0 + 1e-6) <= noise_of(record)[0] * (1.0 + 2e-6)


def test_noise_of_a_channel_that_never_rests_is_not_touched():
    record = motor(stepped())
    assert not held_samples(record.outputs[:, 0]).any()
    assert with_least_noise(record) is record


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_an_output_that_answers_before_its_input_is_a_fault(samples):
    record = late(motor(stepped()), samples)
    fault = next(f for f in detect_faults(record) if f.kind is FaultKind.LEAD)
    assert f"shift = {-0.01 * samples:.6g}" in fault.statement
    assert not assess_usability(record, (fault,)).is_usable


@pytest.mark.parametrize("inductance", [1e-4, 1e-2, 0.1])
@pytest.mark.parametrize("dwell", [15, 30])
def test_causal_motors_do_not_lead(inductance, dwell):
    for seed in range(3):
        record = motor(stepped(seed, dwell=dwell), seed, 50.0, inductance=inductance)
        assert detect_lead(record) is None


def test_an_output_that_answers_at_the_very_sample_and_in_full_does_not_lead():
    u = stepped(1)
    random = np.random.default_rng(2)
    current = u / 1.5 + 0.01 * random.standard_normal(len(u))
    names = (("voltage",), ("current",), ("A",), (Hold.ZERO,))
    assert detect_lead(Record(0.01 * np.arange(len(u)), u[:, None], current[:, None], *names)) is None


def test_a_relay_that_jumps_because_of_the_output_shows_no_lead():
    random = np.random.default_rng(5)
    x, y, u, level = 0.0, np.zeros(3000), np.zeros(3000), 1.0
    for k in range(3000):
        y[k] = x + 0.01 * random.standard_normal()
        level = -1.0 if y[k] > 0.5 else 1.0 if y[k] < -0.5 else level
        u[k] = level
        x += 0.01 * (5.0 * level - x)
    names = (("voltage",), ("speed",), ("rad/s",), (Hold.ZERO,))
    assert detect_lead(Record(0.01 * np.arange(3000), u[:, None], y[:, None], *names)) is None


def smooth(n=1200) -> np.ndarray:
    t = 0.01 * np.arange(n)
    return 3.0 * (np.sin(4.4 * t) + 0.7 * np.sin(12.0 * t + 1.0) + 0.4 * np.sin(27.0 * t))


@pytest.mark.extended
@pytest.mark.parametrize("samples", [0, 1, 2])
def test_a_smooth_input_that_is_late_is_found_by_the_rig_s_model(samples):
    record = late(motor(smooth()), samples)
    fault = detect_late_input(model_for(default_rig("dc_motor"), record), record)
    if samples == 0:
        assert fault is None
    else:
        assert fault is not None
        assert f"shift = {-0.01 * samples:.6g}" in fault.statement


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_an_offset_hides_no_late_input(samples):
    random, terms = np.random.default_rng(3), (*DRY, "constant_force")
    values = {"constant_force.force": 0.05}
    record = driven("dc_motor", smooth(), 0.01, values, terms, 35.0, False, random, CHANNELS)[0]
    record = late(record, samples)
    fault = detect_late_input(model_for(default_rig("dc_motor"), record), record)
    assert (fault is None) == (samples == 0)
    assert fault is None or f"shift = {-0.01 * samples:.6g}" in fault.statement


def proportional(error, before):
    return 2.0 * error


def relay(error, before):
    return before if abs(error) < 0.5 else 6.0 * np.sign(error)


def fed_back(controller, delay, seed, n=1000) -> Record:
    """A motor whose voltage a controller makes of the measured speed, noise included."""
    random, speed, current, voltage = np.random.default_rng(seed), 0.0, 0.0, 6.0
    u, y = np.empty(n), np.empty((n, 2))
    for k in range(n):
        y[k] = np.array([speed, current]) + 0.05 * random.standard_normal(2)
        goal = 5.0 * np.sin(0.02 * k) + 2.0 * np.sin(0.11 * k)
        u[k] = voltage = controller(goal - y[max(k - delay, 0), 0], voltage)
        for _ in range(20):
            current += 0.0005 * (voltage - 1.5 * current - 0.2 * speed) / 0.1
            speed += 0.0005 * (0.2 * current - 0.05 * speed) / 0.1
    names = (("voltage",), ("speed", "current"), ("rad/s", "A"), (Hold.ZERO,))
    return Record(0.01 * np.arange(n), u[:, None], y, *names)


@pytest.mark.extended
@pytest.mark.parametrize("samples", [0, 1, 2])
@pytest.mark.parametrize("controller", [proportional, relay])
def test_in_closed_loop_only_a_late_input_is_a_fault(samples, controller):
    """There a fit of the outputs alone takes an earlier input for better: it is made of their noise."""
    for delay in (0, 1):
        record = late(fed_back(controller, delay, seed=delay), samples)
        model = model_for(default_rig("dc_motor"), record)
        fault = detect_late_input(model, record)
        assert (fault is None) == (samples == 0)
        assert fault is None or f"shift = {-0.01 * samples:.6g}" in fault.statement
        assert unchecked_timing_note(model, record) is None


@pytest.mark.extended
def test_a_deadline_skips_the_late_input_and_keeps_the_other_faults():
    record = late(motor(smooth()), 2)
    model = model_for(default_rig("dc_motor"), record)
    with Deadline(1e-9):
        time.sleep(0.01)
        assert detect_all_faults(model, record) == detect_faults(record)
    assert [fault.kind for fault in detect_all_faults(model, record)] == [FaultKind.LEAD]


def test_where_no_fit_times_the_input_a_note_gives_the_reason():
    motors = default_rig("dc_motor")
    for u in (smooth(), stepped()):
        for samples in (0, 1):
            assert unchecked_timing_note(model_for(motors, motor(u)), late(motor(u), samples)) is None
    t = 1e-3 * np.arange(500)
    pulled = (1.0 + np.sin(9.0 * t))[:, None]
    names = (("coil_current",), ("plunger_position",), ("m",))
    solenoid = Record(t, pulled, 1e-3 * pulled, *names)
    assert "it is measured" in (
        unchecked_timing_note(model_for(default_rig("solenoid"), solenoid), solenoid) or ""
    )


@pytest.mark.extended
def test_the_hold_of_an_input_is_estimated_from_the_data():
    held = motor(smooth())
    fine = motor(np.interp(0.1 * np.arange(12000), np.arange(1200), smooth()), period=0.001)
    straight = replace(fine, t=fine.t[::10], inputs=fine.inputs[::10], outputs=fine.outputs[::10])
    for record, hold in ((held, Hold.ZERO), (straight, Hold.LINEAR)):
        assert estimate_hold(model_for(default_rig("dc_motor"), record), record) is hold
    assert detect_hold(stepped()) is Hold.ZERO
    assert detect_hold(smooth()) is None
    assert detect_hold(np.clip(smooth(), -1.0, 1.0)) is None


@pytest.mark.parametrize("turns", [0.8, 5.0])
@pytest.mark.parametrize("period", [2 * np.pi, 4096 * 1e-3])
def test_an_encoder_that_wraps_is_named_with_its_period(turns, period):
    t = 0.01 * np.arange(3000)
    step = period / 4096
    position = step * np.rint((0.6 * period + turns * period * np.sin(0.3 * t)) / step)
    wraps = detect_wraps(np.mod(position, period))
    assert wraps is not None
    assert wraps.period == pytest.approx(period, rel=1e-3)
    unwrapped = np.unwrap(np.mod(position, period), period=wraps.period)
    assert np.ptp(unwrapped) == pytest.approx(np.ptp(position), rel=1e-3)
    assert detect_wraps(position) is None


def test_single_spikes_are_replaced_wherever_they_fall():
    """Three close together, one right after a jump of the voltage."""
    record = motor(stepped())
    jump = int(np.flatnonzero(np.diff(record.inputs[:, 0]))[20]) + 1
    places = np.array([130, 142, 155, 300, 445, 700, jump + 1, 1100, 1320])
    outputs = record.outputs.copy()
    outputs[places, 0] += 40.0 * (-1.0) ** np.arange(len(places))
    hit = replace(record, outputs=outputs)
    (fault,) = detect_faults(hit)
    assert fault.mended and [begin for begin, _ in fault.times] == record.t[np.sort(places)].tolist()
    mended = replace_outliers(hit)
    assert np.abs(mended.outputs - record.outputs).max() < 12.0 * noise_of(record)[0]
    assert replace_outliers(record) is record
    for samples in (0, 1, 5, 30):
        few = record.part(0, samples)
        assert replace_outliers(few) is few


def test_many_spikes_are_left_where_they_are():
    record = motor(stepped())
    outputs = record.outputs.copy()
    outputs[7::40, 0] += 40.0
    hit = replace(record, outputs=outputs)
    assert replace_outliers(hit) is hit
    (fault,) = detect_faults(hit)
    assert not fault.mended and "leave these samples out" in fault.statement
    assert not assess_usability(hit, (fault,)).is_usable


def test_a_channel_that_answers_every_jump_by_a_pulse_has_no_spikes():
    record = motor(stepped())
    outputs = record.outputs.copy()
    jumps = np.diff(record.inputs[:, 0])
    outputs[1:, 1] += 20.0 * jumps * (np.abs(jumps) > 0.5)
    outputs[[95, 400, 1007], 1] += 100.0
    faults = detect_faults(replace(record, outputs=outputs))
    outliers = [fault for fault in faults if fault.kind is FaultKind.OUTLIER]
    assert [round(begin, 3) for fault in outliers for begin, _ in fault.times] == [0.95, 4.0, 10.07]


def test_a_sensor_that_slips_does_not_wrap():
    t = 0.01 * np.arange(2000)
    x = np.sin(t)
    x[1000:] += 2.3
    assert detect_wraps(x) is None


def test_readings_at_the_end_of_a_range_count_one_sidedly():
    record = motor(stepped())
    limit = np.quantile(record.outputs[:, 0], 0.8)
    outputs = record.outputs.copy()
    outputs[:, 0] = np.minimum(outputs[:, 0], limit)
    marked = mark_censored(with_least_noise(replace(record, outputs=outputs)))
    at = outputs[:, 0] == limit
    assert np.array_equal(marked.censored[:, 0], at.astype(int))
    faults = detect_faults(marked)
    assert [fault.kind for fault in faults] == [FaultKind.SATURATED]
    assert f"{at.sum()} samples" in faults[0].statement
    assert assess_usability(marked, faults).is_usable

    class CompiledForce(type(model_for(default_rig("dc_motor"), marked))):
        def simulate(self, theta, record, windows, states):
            return record.outputs[windows.rows] + 1.0

    model = CompiledForce(default_rig("dc_motor"), marked)
    problem = Problem(model, marked, fit_windows(marked, 1.0), np.empty(0, int), np.zeros(1), np.ones(2))
    residuals = problem.residuals_at(np.zeros(1), problem.guess).reshape(-1, 2)
    assert np.allclose(residuals[:, 0], np.where(at[problem.windows.rows], 0.0, 1.0))
    assert np.allclose(residuals[:, 1], 1.0)
    assert np.array_equal(marked.part(10, 60).censored, marked.censored[10:60])


def test_an_isolated_outlier_of_a_command_is_a_fault():
    record = motor(smooth())
    inputs = record.inputs.copy()
    inputs[[300, 800]] += 40.0
    fault = next(f for f in detect_faults(replace(record, inputs=inputs)) if f.channel == "voltage")
    assert fault.kind is FaultKind.OUTLIER
    pulses = np.zeros(1200)
    pulses[100::200] = 5.0
    assert not any(f.channel == "voltage" for f in detect_faults(motor(pulses)))


def warm_tank(late_by: tuple[int, int]) -> tuple[Model, Record]:
    """A tank that a pump fills and a heater warms, with the stamps of both inputs so many samples late."""
    random, period, n = np.random.default_rng(3), 0.1, 900
    t = period * np.arange(n)
    u = np.column_stack([np.sin(0.9 * t) + np.sin(2.3 * t), np.cos(0.7 * t) + np.sin(1.9 * t)])
    x, y = np.zeros(2), np.empty((n, 2))
    for k in range(n):
        y[k] = x + 0.002 * random.standard_normal(2)
        for _ in range(20):
            x = x + period / 20 * np.array([0.8 * u[k, 0] - 0.5 * x[0], 0.5 * u[k, 1] - 0.9 * x[1]])
    inputs = np.column_stack(
        [np.r_[[0.0] * k, column[: n - k]] for k, column in zip(late_by, u.T, strict=True)]
    )
    names = (("pump", "heater"), ("level", "warmth"), ("m", "K"), (Hold.ZERO, Hold.ZERO))
    stated = RightHandSide(
        states={"level": 0.1, "warmth": 0.1},
        derivative=lambda t, x, u, p: np.array(
            [p["fill"] * u[0] - 0.5 * x[0], p["heat"] * u[1] - p["loss"] * x[1]]
        ),
        output=lambda x, u, p: x,
        guess=lambda t, y: y[0],
        parameters=tuple(
            Parameter(name, "1", 1.0, 1e-3, 10.0, starts=(0.6,)) for name in ("fill", "heat", "loss")
        ),
        horizon=20.0,
    )  # fmt: skip
    return stated(default_rig("dc_motor")), Record(t, inputs, y, *names)


@pytest.mark.extended
@pytest.mark.parametrize("late_by", [(0, 0), (0, 1), (2, 0)])
def test_of_several_inputs_the_one_that_is_late_is_named(late_by):
    model, record = warm_tank(late_by)
    fault = detect_late_input(model, record)
    assert unchecked_timing_note(model, record) is None
    if not any(late_by):
        assert fault is None
    else:
        late_one = int(np.argmax(late_by))
        assert fault is not None
        assert fault.channel == ("pump", "heater")[late_one]
        assert f"shift = {-0.1 * late_by[late_one]:.6g}" in fault.statement


def test_a_late_input_that_moves_only_later_is_found():
    u = np.r_[np.zeros(1200), smooth()]
    record = late(motor(u), 1)
    fault = detect_late_input(model_for(default_rig("dc_motor"), record), record)
    assert fault is not None
    assert "shift = -0.01" in fault.statement
