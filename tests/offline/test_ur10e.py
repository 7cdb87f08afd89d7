"""A real UR10e whose masses nobody states: learned from one recording, predicted on others.

The figures are RMS error over RMS current of a joint where that joint moves: where it rests, dry friction
may take any value and no model can be judged. How the published figures were filtered and what they leave
out is not known, and no definition that was tried reproduces all six of their baseline. Currents filtered
like the model's (the model's own metric) give lower figures than currents as they were recorded, so both
are held against them: the first must be below, the second may be a little above the best of them.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.physics.arm import ArmModel
from labhil.physics.model import index_of, start_values, terms_named
from labhil.physics.record import Windows
from labhil.physics.rigs import record_of
from labhil.recording.reader import read_recording
from labhil.rig import load_rig

RIG = Path(__file__).parents[2] / "docs" / "measured" / "ur10e.toml"
LEARNED = "ur-20_02_19_14harm50sec.csv"
LOADED = "ur-20_02_19_14harm50secLoad.csv"
LOADED_AGAIN = "ur-20_02_19_15harm50secLoad.csv"
FOURIER = "ur-20_02_12-40sec_12harm.csv"
POINT_TO_POINT = "ur-20_01_17-ptp_10_points.csv"

PUBLISHED_BASELINE = np.array([8.5, 4.9, 5.6, 9.9, 13.5, 12.6])
PUBLISHED_BEST = np.array([6.0, 2.3, 3.5, 8.4, 9.6, 9.6])

BASELINE = ["viscous_friction", "coulomb_friction", "sensor_offset"]
RICHER = [*BASELINE, "load_dependent_friction", "cubic_viscous_friction", "added_inertia"]


@pytest.fixture
def arm(labhil, tmp_path):
    """Import a recording of the UR10e by its file's name; skip where the measured data are not."""
    folder = (
        Path(os.environ.get("LABHIL_DATA") or Path(__file__).parents[3] / "shared" / "data") / "arm_ur10e"
    )
    if not folder.is_dir():
        pytest.skip(f"measured data are not here: {folder} (set LABHIL_DATA to the folder above it)")

    def record(name):
        done = labhil("import", folder / name, "--rig", RIG, "-o", "arm.mcap")
        assert done.status == 0, done.err
        recording = read_recording(tmp_path / "arm.mcap")
        (tmp_path / "arm.mcap").unlink()
        return record_of(recording, rig.kind)

    rig = load_rig(RIG)
    return record


def simulated(model, theta, record):
    return model.simulate(theta, record, Windows.of([(0, len(record))]), np.empty((1, 0)))


def learned(model, record, terms):
    """Least squares by the linear parameters, each joint weighted by its own residuals."""
    chosen = {p.key for term in terms_named(model, terms) for p in term.parameters}
    keys = [p.key for p in model.parameters if p.linear and (p.term is None or p.key in chosen)]
    places = [index_of(model.parameters)[key] for key in keys]
    theta = start_values(model.parameters)
    theta[places] = 0.0
    columns = model.regressor(theta, record, keys)
    left = (record.outputs - simulated(model, theta, record)).ravel()
    weights = np.ones(6)
    for _ in range(3):
        w = np.tile(weights, len(record))
        size = np.maximum(np.linalg.norm(columns * w[:, None], axis=0), 1e-12)
        theta[places] = np.linalg.lstsq(columns * w[:, None] / size, left * w, rcond=1e-9)[0] / size
        residuals = (left - columns @ theta[places]).reshape(-1, 6)
        weights = 1.0 / residuals.std(axis=0)
    return theta


def as_recorded(prepared, record):
    """The same rows with the currents as they were recorded."""
    outputs = np.column_stack([np.interp(prepared.t, record.t, column) for column in record.outputs.T])
    return replace(prepared, outputs=outputs)


def error(model, theta, record):
    """RMS error over RMS current of each joint where it moves, %."""
    judged = record.motion.judged[record.places]
    left = np.where(judged, record.outputs - simulated(model, theta, record), 0.0)
    return 100.0 * np.sqrt(np.sum(left**2, axis=0) / np.sum(record.outputs**2 * judged, axis=0))


@pytest.mark.extended
def test_held_out_errors_beside_the_published_figures(arm):
    record = arm(LEARNED)
    model = ArmModel(load_rig(RIG), record)
    fourier = arm(FOURIER)
    learn, judge, points = (model.prepare(r) for r in (record, fourier, arm(POINT_TO_POINT)))
    rough = as_recorded(judge, fourier)
    terms = [*BASELINE, "load_dependent_friction", "cubic_viscous_friction"]
    found = {
        name: [error(model, theta, r) for r in (judge, points, rough)]
        for name, theta in (
            ("baseline", learned(model, learn, BASELINE)),
            ("load", learned(model, learn, [*BASELINE, "load_dependent_friction"])),
            ("nonlinear", learned(model, learn, terms)),
            ("rotors", learned(model, learn, RICHER)),
        )
    }
    assert np.all(found["baseline"][0] < PUBLISHED_BASELINE), found
    assert np.all(found["nonlinear"][0] < PUBLISHED_BEST), found
    assert np.all(found["baseline"][2] < PUBLISHED_BASELINE), found
    assert np.all(found["rotors"][2] < 1.12 * PUBLISHED_BEST), found
    assert np.all(found["rotors"][2][[2, 3, 5]] < PUBLISHED_BEST[[2, 3, 5]]), found
    # friction grows with the load where there is one: shoulder and elbow, in either kind of motion
    for kind in (0, 1):
        better = found["load"][kind] / found["baseline"][kind]
        assert np.all(better[[1, 2]] < 0.7), found
        assert np.all(better[[0, 3, 4, 5]] < 1.05), found
    # the rotors' inertia, which is no part of the links, shows on the wrist
    assert np.all(found["rotors"][0][3:] < 0.85 * found["nonlinear"][0][3:]), found
    assert np.all(found["rotors"][1] < 1.1 * found["nonlinear"][1]), found


@pytest.mark.extended
def test_a_mass_on_the_flange_shows_on_all_joints_that_lift_it(arm):
    """2.805 kg; the torque constants are estimates, and the mass can be no better than they are."""
    record = arm(LEARNED)
    model = ArmModel(load_rig(RIG), record)
    theta = learned(model, model.prepare(record), RICHER)
    loaded = model.prepare(arm(LOADED))
    before = error(model, theta, loaded)
    places = [
        index_of(model.parameters)[f"payload.{name}"] for name in ("mass", "centre_x", "centre_y", "centre_z")
    ]
    noise = (loaded.outputs - simulated(model, theta, loaded)).std(axis=0)
    theta[places] = 1.0, 0.01, 0.01, 0.05

    def residuals(values):
        return ((loaded.outputs - simulated(model, values, loaded)) / noise).ravel()

    for _ in range(8):
        left = residuals(theta)
        slopes = np.empty((len(left), len(places)))
        for k, place in enumerate(places):
            moved = theta.copy()
            moved[place] += 1e-4
            slopes[:, k] = (
                left - ((loaded.outputs - simulated(model, moved, loaded)) / noise).ravel()
            ) / 1e-4
        theta[places] += np.linalg.lstsq(slopes, left, rcond=None)[0]
    assert theta[places[0]] == pytest.approx(2.805, rel=0.2)
    after = error(model, theta, loaded)
    assert np.all(after[1:5] < 0.3 * before[1:5]), (before, after)


def diagnosed(labhil, tmp_path, name):
    """A recording against the fit of an unloaded one: the answer, and what is missing by term and joint."""
    folder = (
        Path(os.environ.get("LABHIL_DATA") or Path(__file__).parents[3] / "shared" / "data") / "arm_ur10e"
    )
    if not folder.is_dir():
        pytest.skip(f"measured data are not here: {folder} (set LABHIL_DATA to the folder above it)")
    rig = RIG.with_name("ur10e_controller.toml")
    for each in (LEARNED, name):
        assert labhil("import", folder / each, "--rig", rig, "-o", f"{each}.mcap").status == 0
    chosen = ("--rig", rig, "--terms", ",".join(BASELINE))
    assert labhil("fit", f"{LEARNED}.mcap", *chosen, "--json", "empty.json").status == 0
    done = labhil("diagnose", f"{name}.mcap", "--rig", rig, "--model", "empty.json", "--json", "said.json")
    assert "Torque constants are the controller's" in done.out
    found = json.loads((tmp_path / "said.json").read_text())
    return found, {(missing["term"], missing["joint"]): missing for missing in found["missing"]}


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("loaded", [LOADED, LOADED_AGAIN])
def test_a_load_that_nobody_told_of_is_found_to_a_few_per_cent(labhil, tmp_path, loaded):
    """The robot carries 2.805 kg that neither its controller nor the model knows of."""
    found, terms = diagnosed(labhil, tmp_path, loaded)
    mass = next(row for row in terms["payload", None]["parameters"] if row["name"] == "payload.mass")
    low, high = mass["ci99"]
    assert low < 2.805 < high
    assert high - low < 0.15 * 2.805
    dry = {joint for term, joint in terms if term == "load_dependent_friction"}
    assert dry == {1, 2}
    assert not [change for change in found["changed"] if change["name"].startswith("grouped")]


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_gears_rub_under_load_and_ripple_with_their_teeth(labhil, tmp_path):
    """Without a load: what a harmonic drive of 1:101 does, 202 times a turn; joints 0 and 3 show it most."""
    _, terms = diagnosed(labhil, tmp_path, FOURIER)
    assert {joint for term, joint in terms if term == "load_dependent_friction"} == {1, 2}
    assert "payload" not in {term for term, _ in terms}
    rippling = {joint: found for (term, joint), found in terms.items() if term == "torque_ripple"}
    assert set(rippling) == {0, 3}
    for found in rippling.values():
        rows = {row["name"]: row for row in found["parameters"]}
        assert rows["torque_ripple.order"]["value"] == 202.0
        assert rows["torque_ripple.sine"]["significant"] or rows["torque_ripple.cosine"]["significant"]
