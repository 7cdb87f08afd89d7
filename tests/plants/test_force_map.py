"""A magnet's measured map in the place of the stated one."""

import numpy as np
import pytest

from labhil.driver import TwinOptions
from labhil.errors import UnknownNameError, UsageError
from labhil.physics.force_map import read_force_map
from labhil.physics.mapped import charted_force
from labhil.plants.force_map import force_map_of, mapped_force
from labhil.plants.solenoid import SolenoidPlant
from labhil.rig import KnownFile
from labhil_sim_solenoid import TWIN

HEADER = "plunger_position, magnetic_force,coil_current"


def table(path, force, currents=(0.0, 0.5, 1.0, 2.0), positions=(0.0, 0.002, 0.005)):
    rows = [f"{x!r},{force(i, x)!r},{i!r}" for i in currents for x in positions]
    path.write_text("\n".join([HEADER, *rows]), encoding="utf-8")
    return path


def magnet(i, x):
    """A smooth magnet that no polynomial of third order follows: an air gap, and iron that saturates."""
    return 60.0 * i * i / (1.0 + 0.4 * i) / (1.0 + x / 0.003) ** 2


def test_between_its_points_a_table_is_a_spline_and_beyond_them_goes_on_straight(tmp_path):
    currents, positions = np.linspace(0.25, 3.0, 12).tolist(), np.linspace(0.0, 0.005, 11).tolist()
    found = force_map_of(table(tmp_path / "map.csv", magnet, currents, positions))
    for i in currents:
        for x in positions:
            assert mapped_force(i, x, found)[0] == pytest.approx(magnet(i, x), rel=1e-9)
    assert mapped_force(1.3, 0.0017, found)[0] == pytest.approx(magnet(1.3, 0.0017), rel=1e-3)
    assert mapped_force(0.0, 0.002, found)[0] == pytest.approx(0.0, abs=1e-12)
    edge, slope = mapped_force(3.0, 0.002, found)
    assert mapped_force(3.5, 0.002, found)[0] == pytest.approx(edge + 0.5 * slope, rel=1e-9)


def test_plant_and_model_are_pulled_alike_by_one_table(tmp_path):
    """Each interpolates in code of its own."""
    currents, positions = np.linspace(0.25, 3.0, 12).tolist(), np.linspace(0.0, 0.005, 11).tolist()
    path = table(tmp_path / "map.csv", magnet, currents, positions)
    found, model = force_map_of(path), read_force_map(KnownFile("map.csv", path.read_bytes()))
    random = np.random.default_rng(0)
    for i, x in random.uniform((-0.5, -0.001), (3.5, 0.006), (500, 2)):
        assert mapped_force(i, x, found)[0] == pytest.approx(
            charted_force(i, x, model.chart), rel=1e-9, abs=1e-9
        )


def test_points_on_no_grid_are_brought_to_one(tmp_path):
    random = np.random.default_rng(1)
    places = random.uniform((0.2, 0.0), (2.0, 0.005), (400, 2))
    path = tmp_path / "map.csv"
    rows = [f"{x!r},{magnet(i, x)!r},{i!r}" for i, x in places.tolist()]
    path.write_text("\n".join([HEADER, *rows]), encoding="utf-8")
    assert mapped_force(1.0, 0.002, force_map_of(path))[0] == pytest.approx(magnet(1.0, 0.002), rel=0.01)


def test_a_plant_is_pulled_by_the_map_that_it_is_given(tmp_path):
    found = force_map_of(table(tmp_path / "map.csv", lambda i, x: 10.0 * i))
    silent = {"plunger_position_noise": 0.0, "magnetic_force_noise": 0.0}
    plant = SolenoidPlant(silent, ["viscous_friction"], force_map=found)
    seen = plant.advance(np.full(3000, 1.0))
    assert seen["plunger_position"][-1] == pytest.approx(10.0 / 6850.0, rel=1e-6)
    assert seen["magnetic_force"][-1] == pytest.approx(10.0, rel=1e-9)


def test_a_table_and_a_number_that_it_replaces_are_one_too_many(tmp_path):
    path = table(tmp_path / "map.csv", magnet)
    options = TwinOptions(tables={"force_map": path}, parameters={"force_map_10": 3.0})
    with pytest.raises(UsageError, match="force_map_10 or a table for force_map, found both"):
        TWIN.serve(options, lambda address: pytest.fail(f"opened {address}"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "expected a CSV file"),
        (f"{HEADER}\n0.001,1.0,x\n", "expected a CSV file"),
        (f"{HEADER}\n0.001,1.0,1.0\n0.002,1.0,1.0\n", "at least"),
        (f"{HEADER}\n", "at least"),
    ],
)
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_a_table_that_is_no_map_is_refused(tmp_path, text, message):
    path = tmp_path / "map.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=message):
        force_map_of(path)


def test_a_twin_knows_its_tables(tmp_path):
    options = TwinOptions(tables={"forcemap": tmp_path / "map.csv"})
    with pytest.raises(UnknownNameError, match="did you mean 'force_map'"):
        TWIN.serve(options, lambda address: pytest.fail(f"opened {address}"))
