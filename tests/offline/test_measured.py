"""Measured data of real rigs against the figures that others publish.

The commands are those of docs/reference/measured-recordings.md.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

ROOT = Path(__file__).parents[2]
RIGS = ROOT / "docs" / "measured"
DATA = Path(os.environ.get("LABHIL_DATA") or ROOT.parent / "shared" / "data")
RPM = 60.0 / (2.0 * np.pi)

SYMMETRIC = "viscous_friction,coulomb_friction,constant_force"
ASYMMETRIC = f"{SYMMETRIC},friction_asymmetry"

pytestmark = [pytest.mark.extended, pytest.mark.timeout(600)]


@pytest.fixture
def fitted(labhil, tmp_path):
    """Import a table once and fit it; the JSON of the fit. Skips where the measured data are not."""

    def fit(table, rig, *arguments):
        source = DATA / table
        if not source.is_file():
            pytest.skip(f"measured data are not here: {source} (set LABHIL_DATA to their folder)")
        recording = tmp_path / f"{source.stem}.mcap"
        if not recording.is_file():
            done = labhil("import", source, "--rig", RIGS / rig, "-o", recording)
            assert done.status == 0, done.err
        done = labhil("fit", recording, "--rig", RIGS / rig, "--json", "fit.json", *arguments)
        assert done.status == 0, done.err
        return json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))

    return fit


def values(result):
    return {row["name"]: row["value"] for row in result["parameters"]}


def forces(part):
    """The row of inverse dynamics, which stands beside the headline."""
    (row,) = [row for row in part["per_channel"] if row["metric"] == "inverse_dynamics"]
    assert part["metric"] == "windowed_simulation"
    assert (row["channel"], row["unit"]) == ("drive_force", "N")
    return row


@pytest.mark.parametrize(
    ("terms", "published", "known"),
    [
        ("constant_force", 0.71, 37.5),
        (SYMMETRIC, 0.0408, 2.12),
        (ASYMMETRIC, 0.0311, 1.56),
    ],
)
def test_the_forces_of_the_positioning_system(fitted, terms, published, known):
    """Janot, Gautier, Brunot 2019: relative error and RMS in N of inverse dynamics at 20 Hz."""
    table = ("axis_emps/DATA_EMPS.mat", "emps.toml")
    whole = fitted(*table, "--criterion", "inverse_dynamics", "--holdout", "0", "--terms", terms)
    row = forces(whole["train"])
    assert row["relative_error"] < published
    assert row["rmse"] < 1.01 * known
    if terms == "constant_force":
        assert row["rmse"] == pytest.approx(known, rel=0.01)
        return
    found = values(whole)
    assert found["moving_mass"] == pytest.approx(95.0, rel=0.01)
    assert found["viscous_friction.coefficient"] == pytest.approx(204.0, rel=0.02)
    assert found["coulomb_friction.level"] == pytest.approx(20.4, rel=0.02)
    held_out = fitted(*table, "--criterion", "inverse_dynamics", "--terms", terms)
    assert forces(held_out["test"])["relative_error"] < published


@pytest.mark.parametrize(("terms", "published"), [(SYMMETRIC, 3.2e-3), (ASYMMETRIC, 1.7e-3)])
def test_the_positioning_system_from_end_to_end_in_open_loop(fitted, terms, published):
    result = fitted(
        *("axis_emps/DATA_EMPS.mat", "emps.toml", "--window", "25", "--holdout", "0", "--terms", terms)
    )
    (left,) = result["left"]
    assert (left["channel"], left["unit"]) == ("position", "m")
    assert left["rmse"] < published


def test_a_motor_coasts_down_under_dry_friction_and_not_behind_a_dead_zone(fitted):
    said = {}
    for term in ("coulomb_friction", "dead_zone"):
        result = fitted(
            *("dc_motor_dead_zone/run_minimal.csv", "dc_motor.toml", "--terms", term),
            *("--span", "48.01", "51", "--window", "3", "--holdout", "0"),
        )
        said[term] = RPM * result["left"][0]["rmse"]
    assert said["coulomb_friction"] < 1.1
    assert said["dead_zone"] > 8.0


def test_friction_of_the_one_joint_that_moves(fitted):
    """0.49 A without friction, 0.064 A with friction that differs by direction are what is known."""
    found = {}
    for name, terms in (
        ("none", "sensor_offset[1]"),
        ("friction", "sensor_offset[1],viscous_friction[1],coulomb_friction[1],friction_asymmetry[1]"),
    ):
        result = fitted("arm_ur3e_rtde/wave_currentData_100v_40a.csv", "ur3e.toml", "--terms", terms)
        found[name] = {part: result[part]["per_channel"][1]["rmse"] for part in ("train", "test")}
    assert found["none"]["train"] == pytest.approx(0.49, rel=0.05)
    assert found["friction"]["train"] < 0.035
    assert found["friction"]["test"] < 0.035


def test_the_acceleration_of_the_ball_on_the_half_that_was_not_fitted(fitted):
    """Known: R² 0.83 to 0.87. Acceleration is the curvature of a parabola through 1 s of positions."""
    table = "ball_beam_daisy/ballbeam.dat"
    found = values(fitted(table, "daisy.toml", "--terms", "time_delay", "--holdout", "0.5"))
    angle, position = np.loadtxt(DATA / table).T
    t = 0.1 * np.arange(len(angle))
    near = 0.1 * np.arange(-5, 6)
    curvature = np.linalg.pinv(np.column_stack([np.ones(11), near, near**2 / 2]))[2]
    acting = np.interp(t - found["time_delay.delay"], t, angle)
    way = cumulative_trapezoid(cumulative_trapezoid(acting, t, initial=0.0), t, initial=0.0)
    half = len(t) // 2
    measured, said = (np.convolve(x, curvature[::-1], "valid")[half:] for x in (position, way))
    left = measured - found["acceleration_per_radian"] * said
    assert 1.0 - np.sum(left**2) / np.sum((measured - measured.mean()) ** 2) > 0.87
