"""Faults of the data: detected where they were added, and none on clean recordings of the plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from labhil.diagnose.frozen import detect_clipping_levels
from labhil.diagnose.intake import Fault, FaultKind, assess_usability, detect_recording_faults
from labhil.identify.windows import noise_of
from labhil.physics.record import Record
from labhil_benchmarks.statistics.arm import arm
from labhil_benchmarks.statistics.cases import STEP, driven, held_ball, levels
from labhil_benchmarks.statistics.noise import noise_like

DRY = ("viscous_friction", "coulomb_friction", "stribeck_friction")
SOME = settings(max_examples=12, deadline=None, derandomize=True)


def ball(seed: int, sigma: float = 4e-4, level: float = 0.09, coloured: bool = False) -> Record:
    """Twenty seconds of a ball that rests now and then, read by ten bits."""
    random = np.random.default_rng(seed)
    values = {"coulomb_friction.level": level, "stribeck_friction.level": 0.5 * level}
    noise = noise_like(2000, sigma, coloured, random)
    return held_ball(DRY, values, noise, random.uniform(0.0, 6.28))


def motor(seed: int, inputs: np.ndarray | None = None, decibels: float = 28.0) -> Record:
    random = np.random.default_rng(seed)
    u = levels(1500, 50, 5.0, random) if inputs is None else inputs
    channels = (("speed", "rad/s"), ("current", "A"))
    return driven("dc_motor", u, 0.01, {}, DRY[:2], decibels, False, random, channels)[0]


def carriage(seed: int, step: float = 0.0) -> Record:
    random = np.random.default_rng(seed)
    u = levels(1500, 60, 80.0, random)
    channels = (("position", "m"),)
    made = driven("axis", u, 0.005, {}, DRY[:2], 60.0, False, random, channels)[0]
    return replace(made, outputs=step * np.rint(made.outputs / step)) if step else made


def plunger(seed: int, *, snap: bool = False, decibels: float = 25.0) -> Record:
    """A plunger that goes from stop to stop and rests there, at 1 kHz."""
    random = np.random.default_rng(seed)
    t = 1e-3 * np.arange(2000)
    u = 1.35 + 0.9 * np.sin(2 * np.pi * t) + 0.45 * np.sin(8 * np.pi * t)
    u = np.where(t % 1.0 > 0.5, 2.2, 0.2) if snap else u
    channels = (("plunger_position", "m"),)
    return driven("solenoid", u, 1e-3, {}, DRY, decibels, False, random, channels)[0]


def faults_in(record: Record) -> tuple[Fault, ...]:
    return detect_recording_faults(record, noise_of(record))


def with_output(record: Record, x: np.ndarray, j: int = 0) -> Record:
    outputs = record.outputs.copy()
    outputs[:, j] = x
    return replace(record, outputs=outputs)


SPINNING = np.repeat([0.0, 0.1, 5.0, 0.0, -4.0, 0.0], 250)
"""Single large steps from rest, one of them within what dry friction holds."""

CLEAN = {
    "ball": ball,
    "ball, quiet sensor": lambda seed: ball(seed, 2e-5),
    "ball that sticks": lambda seed: ball(seed, 1e-4, 0.25),
    "ball, coloured noise": lambda seed: ball(seed, coloured=True),
    "motor": motor,
    "motor in steps, no noise": lambda seed: motor(seed, SPINNING, 300.0),
    "axis": carriage,
    "axis, coarse encoder": lambda seed: carriage(seed, 1e-3),
    "plunger at its stops": plunger,
    "plunger, no noise": lambda seed: plunger(seed, decibels=300.0),
    "plunger that snaps": lambda seed: plunger(seed, snap=True, decibels=50.0),
    "arm": lambda seed: arm(seed, False).record,
}


@pytest.mark.parametrize("what", CLEAN)
def test_clean_recordings_have_no_faults(what):
    for seed in range(2):
        record = CLEAN[what](seed)
        detected = faults_in(record)
        assert detected == (), [fault.statement for fault in detected]
        usability = assess_usability(record, detected)
        assert usability.is_usable
        assert usability.sound.all()


@pytest.fixture(scope="module")
def clean() -> dict[str, Record]:
    return {"ball": ball(1), "motor": motor(1), "axis": carriage(1), "plunger": plunger(1)}


def fault_of_kind(detected: tuple[Fault, ...], kind: FaultKind) -> Fault:
    fault = next((fault for fault in detected if fault.kind is kind), None)
    assert fault is not None, f"no {kind} among {[fault.statement for fault in detected]}"
    return fault


@SOME
@given(name=st.sampled_from(["ball", "motor", "axis"]), place=st.integers(50, 1000), data=st.data())
def test_a_stuck_sensor_is_found_where_it_is(clean, name, place, data):
    record = clean[name]
    length = data.draw(st.integers(120, 400))
    x = record.outputs[:, 0].copy()
    x[place : place + length] = x[place]
    # what freezes right at the extreme looks clipped, and may be; beside a body at rest nothing shows
    assume(x.min() < x[place] < x.max())
    assume(np.ptp(record.outputs[place : place + length, 0]) > 0.05 * np.ptp(x))
    stuck = with_output(record, x)
    fault = fault_of_kind(faults_in(stuck), FaultKind.STUCK)
    (begin, end) = max(fault.times, key=lambda span: span[1] - span[0])
    assert begin == pytest.approx(record.t[place], abs=5 * record.period)
    assert end == pytest.approx(record.t[place + length - 1], abs=5 * record.period)
    assert fault.channel == record.output_names[0]
    assert "stuck" in fault.statement
    usability = assess_usability(stuck, (fault,))
    assert not usability.is_usable
    assert not usability.sound[place + 6 : place + length - 6].any()


@SOME
@given(
    name=st.sampled_from(["ball", "motor", "axis", "plunger"]), share=st.floats(0.04, 0.2), top=st.booleans()
)
def test_a_clipped_sensor_is_found(clean, name, share, top):
    record = clean[name]
    x = record.outputs[:, 0]
    limit = np.quantile(x, 1.0 - share if top else share, method="nearest")
    clipped = with_output(record, np.minimum(x, limit) if top else np.maximum(x, limit))
    detected = faults_in(clipped)
    fault = fault_of_kind(detected, FaultKind.SATURATED)
    assert fault.share >= 0.9 * share
    assert f"{limit:.6g}" in fault.statement
    assert not assess_usability(clipped, detected).is_usable


@SOME
@given(
    name=st.sampled_from(["ball", "motor", "axis", "plunger"]),
    places=st.lists(st.integers(5, 1490), min_size=1, max_size=4, unique_by=lambda i: i // 20),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_spikes_are_found(clean, name, places, sign):
    record = clean[name]
    x = record.outputs[:, 0].copy()
    # a motor answers a step of its voltage at once: in between, a spike is distinct from that
    change = np.abs(np.diff(record.inputs[:, 0]))
    quiet = [i for i in places if i >= 20 and change[i - 6 : i + 4].max() < 0.1 * change.max()]
    height = 60.0 * noise_of(record)[0] + 10.0 * np.abs(np.diff(x)).max()
    x[quiet] += sign * height
    detected = faults_in(with_output(record, x))
    if not quiet:
        return
    fault = fault_of_kind(detected, FaultKind.OUTLIER)
    times = [begin for begin, _ in fault.times]
    assert set(record.t[quiet]) >= set(times)
    assert len(times) >= 0.5 * len(quiet)
    assert assess_usability(record, detected).is_usable


def test_a_sensor_that_slips_is_found(clean):
    record = clean["axis"]
    x = record.outputs[:, 0].copy()
    x[700:] += 20.0 * np.abs(np.diff(x)).max()
    detected = faults_in(with_output(record, x))
    fault = fault_of_kind(detected, FaultKind.ZERO_STEP)
    assert fault.times[0][1] == record.t[700]
    assert not assess_usability(record, detected).is_usable


@SOME
@given(first=st.integers(10, 1000), lost=st.integers(1, 400))
def test_gaps_are_counted(clean, first, lost):
    record = clean["motor"]
    kept = np.r_[np.arange(first), np.arange(first + lost, len(record))]
    holed = replace(record, t=record.t[kept], inputs=record.inputs[kept], outputs=record.outputs[kept])
    detected = faults_in(holed)
    fault = fault_of_kind(detected, FaultKind.GAP)
    assert fault.times == ((record.t[first - 1], record.t[first + lost]),)
    assert f"about {lost} samples" in fault.statement
    assert assess_usability(holed, detected).is_usable is (fault.share <= 0.2)


def test_time_stamps_that_repeat_or_go_back_are_a_fault(clean):
    record = clean["motor"]
    t = record.t.copy()
    t[100], t[200] = t[99], t[198]
    detected = faults_in(replace(record, t=t))
    fault = fault_of_kind(detected, FaultKind.TIME_ORDER)
    assert "1 repeat" in fault.statement
    assert "1 go back" in fault.statement
    assert not assess_usability(record, detected).is_usable


def test_a_sample_that_is_no_number_is_a_fault(clean):
    record = clean["ball"]
    x = record.outputs[:, 0].copy()
    x[300] = np.nan
    detected = detect_recording_faults(with_output(record, x), noise_of(record))
    assert fault_of_kind(detected, FaultKind.NOT_FINITE).times == ((record.t[300], record.t[300]),)


def test_a_clock_drift_is_found():
    t = 0.01 * np.arange(4000)
    random = np.random.default_rng(3)
    angle, late = np.sin(3.0 * t) + 0.4 * np.sin(7.0 * t), t - 1e-3 * t
    speed = 3.0 * np.cos(3.0 * late) + 2.8 * np.cos(7.0 * late) + 1e-3 * random.standard_normal(4000)
    record = Record(
        t, speed[:, None], speed[:, None], ("voltage",), ("speed",), ("rad/s",),
        auxiliary={"angle": angle + 1e-5 * random.standard_normal(4000)},
    )  # fmt: skip
    fault = fault_of_kind(faults_in(record), FaultKind.CLOCK_DRIFT)
    assert (fault.channel, fault.share) == ("speed", 1.0)


def test_missing_excitation_is_reported_but_makes_no_data_unusable(clean):
    record = clean["ball"]
    still = replace(record, inputs=np.zeros_like(record.inputs))
    detected = faults_in(
        with_output(still, STEP * np.rint(noise_like(2000, 4e-4, False, np.random.default_rng(1)) / STEP))
    )
    assert {fault.kind for fault in detected} == {FaultKind.NO_EXCITATION}
    assert len(detected) == 2
    assert assess_usability(still, detected).is_usable


def test_a_channel_that_has_not_moved_yet_is_not_clipped():
    # a temperature without noise, sampled unevenly: its rise looks noisy, its beginning is flat
    random = np.random.default_rng(3)
    t = 0.005 * (np.arange(2000) + 0.1 * random.standard_normal(2000))
    warm = 25.0 + np.maximum(t - 0.4, 0.0) ** 2
    assert detect_clipping_levels(warm) == ()
    noisy = np.minimum(warm + 0.02 * random.standard_normal(2000), 40.0)
    assert detect_clipping_levels(noisy) == (40.0,)
