"""The field solver against fields that are known in closed form, and against itself."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from labhil.errors import MissingExtraError
from labhil.optimise.field import FieldProblem, Solution, load_skfem, solve_solenoid
from labhil.optimise.field_mesh import Section, graded
from labhil.optimise.geometry import HOUSING, ORIGINAL, TEXT_OPTIMUM
from labhil.optimise.steel import FREE_CUTTING, MU0, Steel, flux_density

pytestmark = pytest.mark.extended

SHEET = 30e3
"""Current per length of the long coil, A/m."""


def section(
    r: np.ndarray, z: np.ndarray, steel: np.ndarray, moving: np.ndarray, density: np.ndarray, closed: bool
) -> Section:
    shape = (len(r), len(z))
    radii, heights = np.broadcast_to(r[:, None], shape).copy(), np.broadcast_to(z, shape).copy()
    return Section(radii, heights, steel, moving, density, closed)


def long_coil(steel_core: bool) -> tuple[Solution, np.ndarray]:
    """Ten millimetres of an endless coil, 8 to 10 mm from the axis, with a core of 5 mm or none."""
    r = graded([0.0, 5e-3, 8e-3, 10e-3, 20e-3], 1.0)
    z = np.linspace(0.0, 10e-3, 5)
    middle = np.broadcast_to(0.5 * (r[1:] + r[:-1])[:, None], (len(r) - 1, len(z) - 1))
    core = (middle < 5e-3) & steel_core
    density = np.where((middle > 8e-3) & (middle < 10e-3), SHEET / 2e-3, 0.0)
    problem = FieldProblem(section(r, z, core, core, density, closed=False), FREE_CUTTING)
    return problem.solve(), middle.ravel()


def test_the_field_in_an_endless_coil_is_even() -> None:
    solution, r = long_coil(steel_core=False)
    inside = r < 8e-3
    assert solution.flux_density[1][inside] == pytest.approx(MU0 * SHEET, rel=1e-3)
    assert np.abs(solution.flux_density[0]).max() < 1e-6 * MU0 * SHEET
    outside = r > 11e-3
    assert np.abs(solution.flux_density[1][outside]).max() < 1e-3 * MU0 * SHEET


def test_a_steel_core_in_an_endless_coil_follows_its_curve() -> None:
    solution, r = long_coil(steel_core=True)
    expected = float(flux_density(np.array(SHEET), FREE_CUTTING))
    assert solution.flux_density[1][r < 5e-3] == pytest.approx(expected, rel=1e-3)
    air = (r > 5e-3) & (r < 8e-3)
    assert solution.flux_density[1][air] == pytest.approx(MU0 * SHEET, abs=1e-3 * expected)


def pot(gap: float, turns_current: float) -> Solution:
    """Two halves of a pot core, 10 mm middle pole and a rim of the same area, ``gap`` m apart."""
    a, b = 10e-3, 18e-3
    c, h, t = np.hypot(a, b), 10e-3, 8e-3
    r = graded([0.0, a, b, c, c + 40e-3], 1.0)
    z = graded([-h - t - 40e-3, -h - t, -h, 0.0, gap, gap + h, gap + h + t, gap + h + t + 40e-3], 1.0)
    rm, zm = np.meshgrid(0.5 * (r[1:] + r[:-1]), 0.5 * (z[1:] + z[:-1]), indexing="ij")
    window = (rm > a) & (rm < b) & (zm > -h) & (zm < gap + h)
    steel = (rm < c) & (zm > -h - t) & (zm < gap + h + t) & ~window & ((zm < 0.0) | (zm > gap))
    density = np.where(window, turns_current / ((b - a) * (2 * h + gap)), 0.0)
    linear = Steel(1e4, 1e4 / (1e5 * MU0))
    return FieldProblem(section(r, z, steel, steel & (zm > gap), density, closed=True), linear).solve()


def test_the_pull_between_two_halves_of_a_pot_core() -> None:
    gap, turns_current = 0.2e-3, 200.0
    B = MU0 * turns_current / (2.0 * gap)
    expected = B**2 / (2.0 * MU0) * 2.0 * np.pi * 10e-3**2
    solution = pot(gap, turns_current)
    assert -solution.force == pytest.approx(expected, rel=0.03)
    assert 1.0 < solution.coenergy / (expected * gap) < 1.25  # fringes and window store some more


@pytest.mark.parametrize(("design", "x"), [(ORIGINAL, 2.0e-3), (TEXT_OPTIMUM, 4.0e-3)])
def test_force_is_the_slope_of_the_coenergy(design: np.ndarray, x: float) -> None:
    step = 0.1e-3
    ahead, here, behind = (solve_solenoid(design, at, 2.7, fineness=0.5) for at in (x + step, x, x - step))
    assert -here.force == pytest.approx((ahead.coenergy - behind.coenergy) / (2.0 * step), rel=0.02)


def test_a_finer_grid_changes_little() -> None:
    coarse, fine = (solve_solenoid(ORIGINAL, 1.5e-3, 2.7, fineness=n) for n in (0.5, 1.0))
    assert fine.unknowns > 2 * coarse.unknowns
    assert coarse.force == pytest.approx(fine.force, rel=1e-2)


def test_steel_stays_below_what_it_can_carry() -> None:
    field = solve_solenoid(ORIGINAL, 5e-3, HOUSING.current, fineness=0.5).flux_density
    assert 1.7 < np.hypot(*field).max() < 2.5


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(MissingExtraError, match=r"scikit-fem.*labhil\[field\]"):
        load_skfem()
