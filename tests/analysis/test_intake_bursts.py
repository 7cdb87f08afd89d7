"""Bursts, dropouts and gaps in time: they are detected, leave no residuals, and raise no doubts of units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labhil.diagnose.fault import TOLERATED_SHARE
from labhil.diagnose.intake import FaultKind, assess_usability, detect_faults, replace_outliers
from labhil.identify.plausibility import doubts_of
from labhil.identify.problem import Problem
from labhil.identify.windows import MIN_HOLE_IN_PERIODS, fit_windows, noise_of, scored_windows, split
from labhil.physics.record import UNREAD, Record
from labhil.physics.rigs import model_for
from labhil.rig import default_rig
from labhil.signals import Hold
from labhil_benchmarks.statistics.arm import arm
from labhil_benchmarks.statistics.cases import driven, levels

DRY = ("viscous_friction", "coulomb_friction")
CHANNELS = {
    "dc_motor": (("speed", "rad/s"), ("current", "A")),
    "axis": (("position", "m"),),
}


def moving(kind: str, seed: int = 0, n: int = 1500, dwell: int = 40) -> Record:
    random = np.random.default_rng(seed)
    u = levels(n, dwell, 5.0 if kind == "dc_motor" else 80.0, random)
    period = 0.01 if kind == "dc_motor" else 0.005
    return driven(kind, u, period, {}, DRY, 40.0, False, random, CHANNELS[kind])[0]


def with_first(record: Record, x: np.ndarray) -> Record:
    return replace(record, outputs=np.column_stack([x, record.outputs[:, 1:]]))


def without_rows(record: Record, *cuts: tuple[int, int]) -> Record:
    kept = np.delete(np.arange(len(record)), np.concatenate([np.arange(*cut) for cut in cuts]))
    return replace(record, t=record.t[kept], inputs=record.inputs[kept], outputs=record.outputs[kept])


@pytest.mark.extended
@pytest.mark.parametrize("kind", CHANNELS)
@pytest.mark.parametrize("width", [2, 3, 5, 8])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_wrong_readings_in_a_row_are_found_and_do_not_count(kind, width, sign):
    record = moving(kind)
    x, jumps = record.outputs[:, 0].copy(), np.flatnonzero(np.diff(record.inputs[:, 0]))
    # one begins right at a jump of the input
    places = np.array([130, 512, jumps[20] + 1])
    for place in places:
        x[place : place + width] += sign * 0.8 * np.ptp(record.outputs[:, 0])
    hit = with_first(record, x)
    (fault,) = detect_faults(hit)
    assert fault.kind is FaultKind.OUTLIER
    assert f"up to {width} samples" in fault.statement
    wrong = np.unique((np.sort(places)[:, None] + np.arange(width)).ravel())
    counted = 3 * width <= TOLERATED_SHARE[FaultKind.OUTLIER] * len(record)
    assert fault.mended == counted == assess_usability(hit, (fault,)).is_usable
    if counted:
        mended = replace_outliers(hit)
        assert np.flatnonzero(mended.censored[:, 0] == UNREAD).tolist() == wrong.tolist()
        assert np.abs(mended.outputs - record.outputs).max() < 0.3 * np.ptp(record.outputs[:, 0])


@pytest.mark.parametrize("length", [3, 12, 60])
@pytest.mark.parametrize("value", [0.0, -0.125])
def test_a_channel_that_drops_out_and_comes_back_is_named(length, value):
    record = moving("axis", seed=3)
    record = with_first(record, record.outputs[:, 0] + 2.0)
    x = record.outputs[:, 0].copy()
    x[700 : 700 + length] = value
    (fault,) = detect_faults(with_first(record, x))
    assert fault.times == ((record.t[700], record.t[700 + length - 1]),)
    few = length / len(record) <= TOLERATED_SHARE[FaultKind.STUCK]
    assert fault.kind is (FaultKind.OUTLIER if length == 3 else FaultKind.STUCK)
    assert fault.mended is few
    assert "do not count" in fault.statement if few else f"drops out to {value:g}" in fault.statement


def test_a_sensor_that_drops_out_to_zero_does_not_wrap():
    record = moving("axis", seed=3)
    x = np.round(record.outputs[:, 0] * 0.0 + 0.0064, 6) + 1e-7 * np.arange(len(record))
    for place in (100, 400, 801):
        x[place : place + 2] = 0.0
    assert FaultKind.WRAPPED not in {fault.kind for fault in detect_faults(with_first(record, x))}


def test_a_pulse_that_every_large_step_of_the_input_makes_is_no_burst():
    """The answer of a fast winding, two samples wide; a step of a third of the size makes none to be seen."""
    record = moving("dc_motor")
    jumps = np.flatnonzero(np.diff(record.inputs[:, 0])) + 1
    x = record.outputs[:, 0].copy()
    for jump in jumps[:-1]:
        x[jump : jump + 2] += 0.3 * (record.inputs[jump, 0] - record.inputs[jump - 1, 0])
    assert detect_faults(with_first(record, x)) == ()


def test_slips_out_of_rest_are_no_bursts():
    record = moving("dc_motor")
    random = np.random.default_rng(1)
    x = noise_of(record)[0] * random.standard_normal(len(record))
    for place in range(60, len(record) - 60, 90):
        x[place : place + 3] += 2.0
    ramp = replace(record, inputs=np.linspace(0.0, 1.0, len(record))[:, None])
    assert FaultKind.OUTLIER not in {fault.kind for fault in detect_faults(with_first(ramp, x))}


def test_a_reading_marked_as_unread_leaves_no_residual():
    record = moving("dc_motor")
    x = record.outputs[:, 0].copy()
    x[300:303] += 50.0
    mended = replace_outliers(with_first(record, x))
    model = model_for(default_rig("dc_motor"), mended)
    base = np.array([parameter.scale for parameter in model.parameters])
    problem = Problem(model, mended, fit_windows(mended, 1.0), np.empty(0, int), base, np.ones(2))
    residuals = problem.residuals_at(base, problem.guess).reshape(-1, 2)
    at = np.isin(problem.windows.rows, [300, 301, 302])
    assert not residuals[at, 0].any()
    assert residuals[~at, 0].all()


def test_windows_end_at_a_hole_and_bridge_a_lost_sample():
    record = without_rows(moving("dc_motor"), (300, 301), (600, 800), (1000, 1060))
    holes = np.flatnonzero(np.diff(record.t) > MIN_HOLE_IN_PERIODS * 0.01) + 1
    assert len(holes) == 2
    for windows in (fit_windows(record, 1.3), fit_windows(record, 100.0), scored_windows(record, 1.0).whole):
        for hole in holes:
            assert not np.any((windows.first < hole) & (windows.last > hole))
        assert np.any((windows.first < 300) & (windows.last > 300))
    whole = moving("dc_motor")
    assert len(fit_windows(whole, 1.3)) == round(14.99 / 1.3)


@pytest.mark.parametrize("cut", [(100, 220), (700, 705), (900, 1400)])
def test_a_hole_in_time_is_no_reason_to_doubt_units_or_signs(cut):
    record = without_rows(moving("dc_motor", seed=2), cut)
    assert doubts_of(record, default_rig("dc_motor")) == ()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("period", [0.01, 0.02])
def test_a_chopped_current_that_looks_like_white_noise_is_named(period, sign):
    """On for as much of the time as the duty says, sampled at any moment: no two samples go together."""
    random = np.random.default_rng(7)
    duty = np.repeat(random.uniform(-0.9, 0.9, 50), 40)
    t = period * np.arange(len(duty))
    speed = np.convolve(duty, np.exp(-np.arange(200) / 30.0))[: len(t)] + 0.02 * random.standard_normal(
        len(t)
    )
    conducting = random.uniform(size=len(t)) < np.abs(duty)
    current = 4.0 * np.sign(duty) * conducting + 0.01 * random.standard_normal(len(t))
    names = (("voltage",), ("speed", "current"), ("rad/s", "A"), (Hold.ZERO,))
    record = Record(t, 12.0 * sign * duty[:, None], sign * np.column_stack([speed, current]), *names)
    (fault,) = (f for f in detect_faults(record) if f.channel == "current")
    assert fault.kind is FaultKind.UNDERSAMPLED
    assert "chopper" in fault.statement and not assess_usability(record, (fault,)).is_usable
    # as large a noise that goes both ways is noise
    noisy = speed + np.std(speed) * random.standard_normal(len(t))
    loud = replace(record, outputs=np.column_stack([noisy, speed]))
    assert FaultKind.UNDERSAMPLED not in {fault.kind for fault in detect_faults(loud)}


def test_counts_of_an_encoder_are_no_chopped_current():
    random = np.random.default_rng(8)
    t = 0.01 * np.arange(2000)
    angle = np.cumsum(np.repeat(random.uniform(0.0, 1.5, 40), 50))
    counts = np.diff(np.floor(angle), prepend=0.0)
    names = (("voltage",), ("speed",), ("rad/s",), (Hold.ZERO,))
    record = Record(t, np.repeat(random.uniform(0.0, 5.0, 40), 50)[:, None], counts[:, None] * 0.7, *names)
    assert FaultKind.UNDERSAMPLED not in {fault.kind for fault in detect_faults(record)}


def test_the_held_out_part_is_a_share_of_the_recorded_time():
    whole = moving("dc_motor")
    pause = replace(whole, t=whole.t + np.where(np.arange(len(whole)) >= 5, 300.0, 0.0))
    for train, test in (split(whole, 0.3, 1.0), split(pause, 0.3, 1.0)):
        assert len(train) == pytest.approx(950, abs=2)
        assert len(test) == pytest.approx(450, abs=2)


def test_long_holes_leave_the_rest_fit_for_a_verdict_and_many_lost_samples_do_not():
    record = moving("dc_motor")
    paused = without_rows(record, (200, 900))
    (fault,) = detect_faults(paused)
    assert fault.kind is FaultKind.GAP and "47 % of the recording" in fault.statement
    assert assess_usability(paused, (fault,)).is_usable
    torn = without_rows(record, *((k, k + 4) for k in range(20, 1480, 11)))
    faults = detect_faults(torn)
    assert not assess_usability(torn, faults).is_usable


def test_accelerations_that_are_planned_may_stand_still_and_jump():
    record = arm(1, False).record
    planned = np.tile(np.repeat([0.0, 2.0, 0.0, -2.0, 0.0, -1.0], 13), len(record))[: len(record)]
    more = replace(
        record,
        inputs=np.column_stack([record.inputs, planned]),
        input_names=(*record.input_names, "target_qdd_0"),
        input_holds=(*record.input_holds, Hold.LINEAR),
    )
    assert detect_faults(more) == detect_faults(record) == ()


@pytest.mark.parametrize("kind", CHANNELS)
@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize("at_the_end", [False, True])
def test_wrong_readings_at_an_end_are_found(kind, width, at_the_end):
    record = moving(kind, seed=5)
    x = record.outputs[:, 0] + np.ptp(record.outputs[:, 0])
    places = np.arange(len(x) - width, len(x)) if at_the_end else np.arange(width)
    x[places] = 0.0
    hit = with_first(record, x)
    (fault,) = detect_faults(hit)
    assert (fault.kind, fault.mended) == (FaultKind.OUTLIER, True)
    assert fault.times == ((record.t[places[0]], record.t[places[-1]]),)
    assert np.flatnonzero(replace_outliers(hit).censored[:, 0] == UNREAD).tolist() == places.tolist()
