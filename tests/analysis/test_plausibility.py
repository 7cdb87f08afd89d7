"""Wrong units, signs, times and swapped columns are proposed; right data of every kind are left alone."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay, rig_of, staircase, two_tones
from test_arm_model import acquired

from labhil.identify.plausibility import doubts_of
from labhil.physics.joining import join_records
from labhil.physics.record import Record
from labhil.rig import parse_rig

BEAM = "ball_mass = 0.261\nball_radius = 0.02\ncrank_radius = 0.08\nbeam_length = 0.40\n"
DEGREES = 180.0 / np.pi


@pytest.fixture(scope="module")
def ball(acquire) -> Record:
    return acquire(["viscous_friction", "coulomb_friction"], 5, duration=12.0)


def motor(seed: int = 1, terms=("viscous_friction", "coulomb_friction")) -> Record:
    u = staircase(12.0, 0.01, 0.6, 6.0, seed)
    return replay("dc_motor", u, terms, noise={"speed_noise": 0.02, "current_noise": 0.02}, seed=seed).record


def inertia_of_the_plant() -> float:
    from labhil.plants.rigs import plant_of

    return float(plant_of("dc_motor", {}, (), 0, 0.01).parameters["inertia"])


def scaled(record: Record, *, t: float = 1.0, **factors: float) -> Record:
    """The record with channels (by name) and the time multiplied."""
    inputs, outputs = record.inputs.copy(), record.outputs.copy()
    for names, columns in ((record.input_names, inputs), (record.output_names, outputs)):
        for j, name in enumerate(names):
            columns[:, j] *= factors.get(name, factors.get(name.rstrip("012345").rstrip("_"), 1.0))
    return replace(record, t=t * record.t, inputs=inputs, outputs=outputs)


def lines(record: Record, kind: str, known: str = "", **how: Any) -> tuple[str, ...]:
    found = doubts_of(record, rig_of(kind, known), **how)
    return tuple(line for doubt in found for line in doubt.lines)


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ({"servo_angle": DEGREES}, 'servo_angle = { column = "servo_angle", scale = 0.017453293 }'),
        ({"ball_position": 1e3}, 'ball_position = { column = "ball_position", scale = 0.001 }'),
        ({"ball_position": 1e2}, 'ball_position = { column = "ball_position", scale = 0.01 }'),
        ({"t": 1e3}, 't = { column = "t", scale = 0.001 }'),
        ({"t": 1e6}, 't = { column = "t", scale = 1e-06 }'),
    ],
)
def test_units_of_a_ball_on_a_beam_show_by_gravity_and_lengths(ball, factors, expected):
    assert lines(scaled(ball, **factors), "ball_beam", BEAM) == (expected,)


def test_a_column_of_the_time_is_called_what_it_is_called_in_the_table(ball):
    found = lines(scaled(ball, t=1e3), "ball_beam", BEAM, time_column="Time [s]")
    assert found == ('t = { column = "Time [s]", scale = 0.001 }',)


def test_two_wrong_units_at_once_are_both_found(ball):
    found = lines(scaled(ball, servo_angle=DEGREES, ball_position=1e3), "ball_beam", BEAM)
    assert len(found) == 2
    assert all("scale = 0.0" in line for line in found)


def test_of_several_recordings_the_doubtful_one_is_numbered(ball):
    both = join_records([ball, scaled(ball, servo_angle=DEGREES)])
    (doubt,) = doubts_of(both, rig_of("ball_beam", BEAM))
    assert doubt.statement.startswith("Recording 2: ")


def test_either_of_two_signs_may_be_wrong_where_only_their_product_is_seen(ball):
    found = lines(scaled(ball, ball_position=-1.0), "ball_beam", BEAM)
    assert len(found) == 2
    assert all(line.endswith("scale = -1 }") for line in found)


def test_swapped_columns_of_a_ball_on_a_beam(ball):
    swapped = replace(ball, inputs=ball.outputs, outputs=ball.inputs)
    assert lines(swapped, "ball_beam", BEAM) == (
        'servo_angle = { column = "ball_position" }',
        'ball_position = { column = "servo_angle" }',
    )


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ({"speed": 30.0 / np.pi}, 'speed = { column = "speed", scale = 0.10471976 }'),
        ({"speed": DEGREES}, 'speed = { column = "speed", scale = 0.017453293 }'),
        ({"speed": -1.0}, 'speed = { column = "speed", scale = -1 }'),
        ({"current": -1.0}, 'current = { column = "current", scale = -1 }'),
        ({"voltage": -1.0}, 'voltage = { column = "voltage", scale = -1 }'),
        ({"t": 1e3}, 't = { column = "t", scale = 0.001 }'),
    ],
)
def test_units_and_signs_of_a_motor_show_by_its_two_balances(factors, expected):
    known = f"inertia = {inertia_of_the_plant()}\n"
    assert lines(scaled(motor(), **factors), "dc_motor", known) == (expected,)


def test_a_swap_of_speed_and_current_is_proposed_where_the_model_does_not_explain_them():
    record = motor()
    swapped = replace(record, outputs=record.outputs[:, ::-1])
    assert lines(swapped, "dc_motor", misfit=True) == (
        'speed = { column = "current" }',
        'current = { column = "speed" }',
    )


def test_an_arm_in_degrees_shows_by_its_reach_and_by_the_derivative():
    record = acquired(["viscous_friction"], seconds=6.0)
    both = lines(scaled(record, actual_q=DEGREES, actual_qd=DEGREES), "ur5")
    assert [line.split(" =")[0] for line in both] == ["actual_q", "actual_qd"]
    (one,) = lines(scaled(record, actual_qd=DEGREES), "ur5")
    assert one == 'actual_qd = { column = "actual_qd", scale = 0.017453293 }'
    (amps,) = lines(scaled(record, actual_current=1e3), "ur5")
    assert amps.startswith("actual_current = ")
    assert lines(scaled(record, t=1e3), "ur5") == ('t = { column = "t", scale = 0.001 }',)


@pytest.mark.extended
def test_a_plunger_in_millimetres_and_an_axis_that_counts_backwards():
    plunger = replay("solenoid", two_tones(1.5), ("viscous_friction",), period=1e-3).record
    assert lines(scaled(plunger, plunger_position=1e3), "solenoid") == (
        'plunger_position = { column = "plunger_position", scale = 0.001 }',
    )
    axis = replay("axis", staircase(10.0, 0.005, 0.5, 120.0), ("viscous_friction",), period=0.005).record
    found = lines(scaled(axis, position=-1.0), "axis")
    assert 'position = { column = "position", scale = -1 }' in found


def test_the_line_keeps_what_the_rig_file_says_of_the_channel(ball):
    text = '[rig]\nkind = "ball_beam"\n[known]\n' + BEAM
    text += '[channels]\nservo_angle = { column = "gamma", scale = 2.0, offset = 1.0 }\n'
    (doubt,) = doubts_of(scaled(ball, servo_angle=DEGREES), parse_rig(text, Path("rig.toml")))
    assert doubt.lines == ('servo_angle = { column = "gamma", scale = 0.034906585, offset = 0.017453293 }',)
    assert "Nothing was changed" in doubt.statement


EFFECTS = {
    "dc_motor": ("stribeck_friction", "constant_force", "brush_drop", "time_delay", "dead_zone", "backlash"),
    "axis": ("stribeck_friction", "spring_force", "constant_force", "friction_asymmetry", "dead_zone"),
    "solenoid": ("coulomb_friction", "eddy_current", "spring_preload", "magnetic_saturation"),
}
INPUTS = {
    "dc_motor": (lambda seed: staircase(10.0, 0.01, 0.7, 6.0, seed), 0.01),
    "axis": (lambda seed: staircase(10.0, 0.005, 0.5, 120.0, seed), 0.005),
    "solenoid": (lambda seed: two_tones(1.5), 1e-3),
}


@pytest.mark.parametrize("kind", list(EFFECTS))
def test_right_recordings_are_left_alone_whatever_their_physics(kind):
    make, period = INPUTS[kind]
    for seed, term in enumerate(EFFECTS[kind]):
        record = replay(kind, make(seed), ("viscous_friction", term), period=period, seed=seed).record
        assert doubts_of(record, rig_of(kind), misfit=True) == (), term


@pytest.mark.parametrize("term", ["dead_zone", "time_delay", "backlash", "spring_force", "stribeck_friction"])
def test_a_right_ball_and_beam_is_left_alone_with_and_without_known_sizes(acquire, term):
    record = acquire(["viscous_friction", term], 3, duration=8.0)
    for known in (BEAM, ""):
        assert doubts_of(record, rig_of("ball_beam", known), misfit=True) == ()


def test_a_right_arm_is_left_alone():
    assert doubts_of(acquired(["coulomb_friction"], seconds=6.0), rig_of("ur5"), misfit=True) == ()


@pytest.mark.parametrize(("seed", "width"), [(2, 1), (1, 2), (3, 2), (1, 3), (3, 3)])
def test_bursts_are_no_reason_to_doubt_a_sign_or_columns(seed, width):
    record = motor(seed)
    outputs = record.outputs.copy()
    places = np.random.default_rng(seed).choice(len(record) - 3, 10, replace=False)
    outputs[(places[:, None] + np.arange(width)).ravel(), 0] += 40.0
    assert doubts_of(replace(record, outputs=outputs), rig_of("dc_motor"), misfit=True) == ()
