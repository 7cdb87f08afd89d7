"""A magnet's measured map in the place of the stated one."""

import numpy as np
import pytest

from labhil.driver import TwinOptions
from labhil.errors import UnknownNameError, UsageError
from labhil.plants.force_map import force_map_of
from labhil.plants.solenoid import SolenoidPlant
from labhil.plants.solenoid_world import FORCE_MAP
from labhil_sim_solenoid import TWIN

HEADER = "plunger_position, magnetic_force,coil_current"


def table(path, force, currents=(0.0, 0.5, 1.0, 2.0), positions=(0.0, 0.002, 0.005)):
    rows = [f"{x!r},{force(i, x)!r},{i!r}" for i in currents for x in positions]
    path.write_text("\n".join([HEADER, *rows]), encoding="utf-8")
    return path


def test_a_table_of_the_stated_magnet_gives_its_numbers(tmp_path):
    def force(i, x):
        y = x / 0.005
        return i * (8.0 + 2.0 * y - 3.0 * y * y + i * (12.0 + 1.5 * y - 2.0 * i))

    found = force_map_of(table(tmp_path / "map.csv", force))
    assert found == pytest.approx(FORCE_MAP)


def test_a_plant_is_pulled_by_the_map_that_it_is_given(tmp_path):
    found = force_map_of(table(tmp_path / "map.csv", lambda i, x: 10.0 * i))
    plant = SolenoidPlant(
        {**found, "plunger_position_noise": 0.0, "magnetic_force_noise": 0.0}, ["viscous_friction"]
    )
    seen = plant.advance(np.full(3000, 1.0))
    assert seen["plunger_position"][-1] == pytest.approx(10.0 / 6850.0, rel=1e-6)
    assert seen["magnetic_force"][-1] == pytest.approx(10.0, rel=1e-9)


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
