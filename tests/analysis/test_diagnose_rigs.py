"""Diagnoses of every kind of rig: the concealed effect of an independent plant is named, and no other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.diagnose.diagnosis import diagnose
from labhil.physics.rigs import model_for, rig_model
from labhil.rig import parse_rig
from labhil_benchmarks.statistics import arm
from labhil_benchmarks.statistics.cases import driven, levels

pytestmark = pytest.mark.timeout(600)
"""A diagnosis of a rough model takes a minute or two on a machine that does other work too."""

MOTOR = (("speed", "rad/s"), ("current", "A"))
RIGS = {
    "axis": '[rig]\nkind = "axis"\n',
    "dc_motor": '[rig]\nkind = "dc_motor"\n',
    "solenoid": '[rig]\nkind = "solenoid"\n[known]\nmoving_mass = 0.064\nspring_stiffness = 6850.0\n'
    "stop_low = 0.0\nstop_high = 0.005\n",
}


def recorded(kind, concealed, values, seed):
    random = np.random.default_rng(seed)
    terms = (*rig_model(kind).baseline, *concealed)
    records = []
    for n in (2500, 1800):
        if kind == "dc_motor":
            inputs, period, decibels, channels = levels(n, 50, 5.0, random), 0.01, 28.0, MOTOR
        elif kind == "axis":
            inputs, period, decibels, channels = (
                levels(n, 60, 80.0, random),
                0.005,
                60.0,
                (("position", "m"),),
            )
        else:
            t = 0.001 * np.arange(n)
            a, b = random.uniform(0.0, 2.0 * np.pi, 2)
            inputs = 1.0 + 0.33 * np.sin(2.0 * np.pi * t + a) + 0.2 * np.sin(8.0 * np.pi * t + b)
            period, decibels, channels = 0.001, 25.0, (("plunger_position", "m"),)
        made = driven(kind, inputs, period, values, terms, decibels, False, random, channels)
        records.append(made[0])
    return records


def diagnosed(kind, concealed=(), values=None, seed=1):
    searched, test = recorded(kind, concealed, values or {}, seed)
    model = model_for(parse_rig(RIGS[kind], Path(f"{kind}.toml")), searched)
    return diagnose(
        model, searched, test, heldout_is_test=True, baseline=rig_model(kind).baseline, measured=searched
    )


@pytest.mark.extended
@pytest.mark.parametrize(
    "kind",
    [
        "dc_motor",
        pytest.param("axis", marks=pytest.mark.extended),
        pytest.param("solenoid", marks=pytest.mark.extended),
    ],
)
def test_no_effect_is_found_where_none_is_concealed(kind):
    found = diagnosed(kind)
    assert found.verdict == "no_mismatch"
    assert found.missing == ()
    assert found.location is None


@pytest.mark.parametrize(
    ("kind", "concealed", "enters"),
    [
        pytest.param("dc_motor", ("dead_zone",), "input", marks=pytest.mark.extended),
        pytest.param("dc_motor", ("coulomb_friction",), "force", marks=pytest.mark.extended),
        pytest.param("dc_motor", ("brush_drop",), "electrical", marks=pytest.mark.extended),
        pytest.param("axis", ("stribeck_friction",), "force", marks=pytest.mark.extended),
        pytest.param("solenoid", ("coulomb_friction",), "force", marks=pytest.mark.extended),
        pytest.param("solenoid", ("magnetic_hysteresis",), "magnetic", marks=pytest.mark.long),
    ],
)
def test_a_concealed_effect_is_named_located_and_modelled(kind, concealed, enters):
    found = diagnosed(kind, concealed)
    assert found.verdict == "missing_physics"
    assert [item.term for item in found.missing] == list(concealed)
    assert found.location.enters == enters
    assert found.after.rmse < 1.1 * found.after.noise_floor < 0.9 * found.before.rmse


@pytest.mark.long
def test_a_hold_without_width_is_no_stribeck_peak():
    found = diagnosed("axis", ("static_friction",), {"static_friction.level": 15.0})
    assert [item.term for item in found.missing] == ["static_friction"]
    (row,) = found.missing[0].parameters
    assert row.ci99[0] < 15.0 < row.ci99[1]


@pytest.mark.extended
def test_a_term_that_others_build_on_is_not_named_where_it_is_negligible():
    found = diagnosed(
        "dc_motor",
        ("stribeck_friction",),
        {"stribeck_friction.level": 0.1, "stribeck_friction.velocity": 1.0},
    )
    assert [item.term for item in found.missing] == ["stribeck_friction"]
    assert "coulomb_friction" in found.final_terms


@pytest.mark.long
def test_play_in_a_drive_is_named_although_its_size_is_uncertain():
    """The cost of long windows of a drive with play has many minima: short ones give the answer."""
    found = diagnosed("axis", ("backlash",))
    assert [item.term for item in found.missing] == ["backlash"]
    assert found.location.enters == "input"
    assert found.after.rmse < 0.3 * found.before.rmse


def arm_diagnosed(concealed, values):
    terms = (*rig_model("ur5").baseline, *concealed)
    random = np.random.default_rng(5)
    clean = [arm.follow(terms, {**arm.SILENT, **values}, seed) for seed in (1, 2)]
    searched, test = (
        replace(each, outputs=each.outputs + arm.noise(len(each), False, random)) for each in clean
    )
    model = model_for(parse_rig(arm.RIG, Path("ur5.toml")), searched)
    return diagnose(
        model,
        model.prepare(searched),
        model.prepare(test),
        heldout_is_test=True,
        baseline=rig_model("ur5").baseline,
        measured=searched,
    )


@pytest.mark.extended
def test_a_load_on_the_gear_is_found_on_its_joint():
    share = tuple(0.1 * (joint == 1) for joint in range(6))
    found = arm_diagnosed(("load_dependent_friction",), {"load_dependent_friction.coefficient": share})
    assert [(item.term, item.joint) for item in found.missing] == [("load_dependent_friction", 1)]
    assert found.location.joint == 1
    (row,) = found.missing[0].parameters
    assert row.ci99[0] < 0.1 < row.ci99[1]
    assert found.after.rmse < 1.1


@pytest.mark.extended
def test_a_payload_is_weighed():
    found = arm_diagnosed(("payload",), {"payload.mass": 1.5})
    assert [item.term for item in found.missing] == ["payload"]
    mass = next(row for row in found.missing[0].parameters if row.name == "payload.mass")
    assert mass.ci99[0] < 1.5 < mass.ci99[1]
    assert found.location.enters == "load"


@pytest.mark.extended
def test_an_arm_without_concealed_effects_has_none():
    assert arm_diagnosed((), {}).verdict == "no_mismatch"


def test_a_stuck_channel_is_a_fault_of_the_data():
    searched, test = recorded("axis", (), {}, 3)
    frozen = searched.outputs.copy()
    frozen[1200:1500] = frozen[1200]
    searched = replace(searched, outputs=frozen)
    model = model_for(parse_rig(RIGS["axis"], Path("axis.toml")), searched)
    found = diagnose(
        model, searched, test, heldout_is_test=True, baseline=rig_model("axis").baseline, measured=searched
    )
    assert found.verdict == "data_fault"
    assert "stuck" in found.faults[0].statement
