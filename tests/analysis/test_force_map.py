"""A magnet's measured forces as the fitted model uses them: the table itself, and no polynomial near it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labhil.errors import RigFileError
from labhil.physics.force_map import read_force_map
from labhil.physics.mapped import charted_force, charted_slope
from labhil.physics.model import start_values
from labhil.physics.record import Record, Windows
from labhil.physics.solenoid import SolenoidModel
from labhil.rig import KnownFile, parse_rig

CURRENT, POSITION = np.linspace(0.0, 3.0, 13), np.linspace(0.0, 5e-3, 11)


def magnet(i, x):
    """Iron that saturates and a pole that comes near: smooth, and no polynomial of third order."""
    return 60.0 * i * (1.0 - np.exp(-i)) * (1.0 + 0.3 * np.tanh((x - 2e-3) / 1.5e-3))


def written(path: Path, i, x, force) -> Path:
    rows = [f"{a!r},{b!r},{c!r}" for a, b, c in zip(i.tolist(), x.tolist(), force.tolist(), strict=True)]
    path.write_text("\n".join(["coil_current,plunger_position,magnetic_force", *rows]), encoding="utf-8")
    return path


def grid(path: Path, current=CURRENT, position=POSITION) -> Path:
    i, x = (each.ravel() for each in np.meshgrid(current, position, indexing="ij"))
    return written(path, i, x, magnet(i, x))


def taken(path: Path) -> KnownFile:
    return KnownFile(str(path), path.read_bytes())


def test_a_table_on_a_grid_is_used_as_given(tmp_path):
    found = read_force_map(taken(grid(tmp_path / "map.csv")))
    assert found.worst < 1e-9
    between = [(i, x) for i in (0.4, 1.3, 2.6) for x in (0.3e-3, 2.2e-3, 4.6e-3)]
    for i, x in between:
        assert charted_force(i, x, found.chart) == pytest.approx(magnet(i, x), abs=0.15)
        step = (charted_force(i, x + 1e-7, found.chart) - charted_force(i, x - 1e-7, found.chart)) / 2e-7
        assert charted_slope(i, x, found.chart) == pytest.approx(step, rel=1e-5, abs=1e-3)


def test_a_table_with_uneven_steps_is_met_at_its_points(tmp_path):
    uneven = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.25, 3.0])
    assert read_force_map(taken(grid(tmp_path / "map.csv", uneven))).worst < 1e-9


def test_beyond_its_edges_a_table_goes_on_straight_and_a_recording_that_leaves_it_is_told(tmp_path):
    found = read_force_map(taken(grid(tmp_path / "map.csv")))
    edge, before = charted_force(3.0, 2e-3, found.chart), charted_force(3.0 - 1e-5, 2e-3, found.chart)
    assert charted_force(3.3, 2e-3, found.chart) == pytest.approx(
        edge + 0.3 * (edge - before) / 1e-5, rel=1e-3
    )
    inside = found.notes(np.array([0.0, 3.01]), np.array([0.0, 5e-3]))
    outside = found.notes(np.array([0.0, 3.5]), np.array([0.0, 5e-3]))
    assert (len(inside), len(outside)) == (1, 2)
    assert "goes on straight" in inside[0] and "coil_current leaves the table in 50 %" in outside[1]


def test_scattered_points_are_told_what_a_grid_costs_them(tmp_path):
    random = np.random.default_rng(5)
    i, x = random.uniform(0.2, 3.0, 200), random.uniform(0.0, 5e-3, 200)
    found = read_force_map(taken(written(tmp_path / "map.csv", i, x, magnet(i, x))))
    assert 0.0 < found.rms < 0.1 and "on no grid" in found.notes(i, x)[0]
    assert charted_force(0.0, 2e-3, found.chart) == pytest.approx(0.0, abs=0.1)


@pytest.mark.filterwarnings("ignore:loadtxt")
def test_points_on_a_line_are_no_map(tmp_path):
    i = np.linspace(0.0, 1.0, 9)
    with pytest.raises(RigFileError, match="two currents and two positions"):
        read_force_map(taken(written(tmp_path / "map.csv", i, np.full(9, 1e-3), i)))
    with pytest.raises(RigFileError, match="span an area"):
        read_force_map(taken(written(tmp_path / "map.csv", i, 1e-3 * i, i)))


@pytest.mark.extended
def test_the_model_moves_by_the_table(tmp_path):
    path = grid(tmp_path / "map.csv")
    rig = parse_rig(f'[rig]\nkind = "solenoid"\n[known]\nforce_map = "{path}"\n', tmp_path / "rig.toml")
    t = 1e-3 * np.arange(2000)
    record = Record(
        t, np.full((2000, 1), 0.3), np.full((2000, 1), 1e-3), ("coil_current",), ("plunger_position",), ("m",)
    )
    model = SolenoidModel(rig, record)
    theta = start_values(model.parameters)
    keys = [p.key for p in model.parameters]
    theta[keys.index("viscous_friction.coefficient")] = 20.0
    theta[keys.index("spring_stiffness")] = stiffness = 2000.0  # it rests between the stops
    at_rest = model.simulate(theta, record, Windows.of([(0, 2000)]), np.zeros((1, 2)))[-1, 0]
    # where it ends the magnet holds the spring
    assert 0.0 < at_rest < 5e-3
    assert stiffness * at_rest == pytest.approx(magnet(0.3, at_rest), rel=0.02)
