"""The solenoid's magnetic circuit: physics that any such circuit must have, and the field solver's word."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.errors import UsageError
from labhil.optimise.circuit import force_curves, positions
from labhil.optimise.geometry import HOUSING, LEVELS, LOWER, ORIGINAL, SHOWN, TEXT_OPTIMUM, UPPER
from labhil.optimise.steel import FREE_CUTTING, MU0, Steel, flux_density, magnetisation, magnetisation_all

pytestmark = pytest.mark.extended

CENTRE = LEVELS[:, 2]
UNSATURATED = Steel(1e4, 1e4 / (2000.0 * MU0))
"""Linear, with a relative permeability of 2000, as far as these tests go."""


def test_steel_turns_its_own_formula_around() -> None:
    H = np.array([0.0, 3.0, 700.0, 5e3, 1e5, 2e6])
    B = flux_density(H, FREE_CUTTING)
    assert magnetisation_all(B, FREE_CUTTING)[0] == pytest.approx(H, rel=1e-7, abs=1e-9)
    assert [magnetisation(b, FREE_CUTTING)[0] for b in B] == pytest.approx(H, rel=1e-7, abs=1e-9)


def test_steel_stores_what_was_put_into_it() -> None:
    B = np.linspace(0.0, 3.0, 3001)
    H, slope, stored = magnetisation_all(B, FREE_CUTTING)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (H[1:] + H[:-1]) * np.diff(B))])
    assert stored == pytest.approx(work, rel=1e-4, abs=1e-3)
    assert np.gradient(H, B)[1:-1] == pytest.approx(slope[1:-1], rel=0.02)
    assert [magnetisation(b, FREE_CUTTING) for b in B[::500]] == [
        pytest.approx(row) for row in zip(H[::500], slope[::500], stored[::500], strict=True)
    ]


def test_without_saturation_force_goes_with_the_square_of_the_current() -> None:
    one = force_curves(CENTRE, current=1.0, steel=UNSATURATED)
    three = force_curves(CENTRE, current=3.0, steel=UNSATURATED)
    assert three == pytest.approx(9.0 * one, rel=1e-4)


def test_saturation_takes_force_away() -> None:
    free = force_curves(CENTRE, steel=UNSATURATED)
    bound = force_curves(CENTRE)
    assert np.all(bound < free)
    assert bound[0, -1] < 0.5 * free[0, -1]


def test_force_pulls_inwards_everywhere_and_is_of_the_size_the_text_reports() -> None:
    curves = force_curves(np.vstack([ORIGINAL, TEXT_OPTIMUM, LOWER, UPPER]))
    assert curves.shape == (4, len(positions()))
    assert np.all(curves > 0.0)
    assert 60.0 < curves[0].max() < 100.0  # 78.9 N in the text


@pytest.mark.parametrize("j", range(5))
def test_every_parameter_acts(j: int) -> None:
    designs = np.tile(CENTRE, (5, 1))
    designs[:, j] = LEVELS[j]
    curves = force_curves(designs)
    assert np.abs(np.diff(curves, axis=0)).max(axis=1).min() > 0.3


def test_a_deep_recess_pulls_from_afar_and_a_thick_plunger_pulls_hard() -> None:
    shallow, deep = CENTRE.copy(), CENTRE.copy()
    shallow[1], deep[1] = LEVELS[1, 0], LEVELS[1, 4]
    weak, strong = force_curves(np.vstack([shallow, deep]))[:, 0]
    assert strong > 2.0 * weak
    thin, thick = np.tile(CENTRE, (2, 1))
    thin[0], thick[0] = LEVELS[0, 0], LEVELS[0, 4]
    assert np.greater(*force_curves(np.vstack([thick, thin])).max(axis=1))


def test_a_cone_levels_the_peak_where_the_corners_pass() -> None:
    flat, cone = np.tile(ORIGINAL, (2, 1))
    cone[4] = np.deg2rad(8.0)
    peaks = force_curves(np.vstack([flat, cone]))[:, :7].max(axis=1)
    assert peaks[1] < 0.8 * peaks[0]


def test_a_batch_is_the_same_as_its_designs_one_by_one() -> None:
    designs = LOWER + np.random.default_rng(3).random((9, 5)) * (UPPER - LOWER)
    together = force_curves(designs)
    assert together == pytest.approx(np.vstack([force_curves(design) for design in designs]), rel=1e-5)


def test_designs_that_cannot_be_built_are_refused() -> None:
    thick = CENTRE.copy()
    thick[0] = 30e-3
    with pytest.raises(UsageError, match="R 30 mm"):
        force_curves(thick)
    with pytest.raises(UsageError, match="rows of 5 numbers"):
        force_curves(np.ones((2, 4)))
    with pytest.raises(UsageError, match="θ nan°"):
        force_curves(np.where(np.arange(5) == 4, np.nan, CENTRE))


@pytest.mark.parametrize(
    ("design", "x", "current"),
    [
        (ORIGINAL, 3.0e-3, 2.7),
        (TEXT_OPTIMUM, 4.0e-3, 2.7),
        (np.array([9.0, 3.5, 5.5, 3.0, 14.0]) / SHOWN, 1e-3, 1.0),
    ],
)
def test_the_field_solver_agrees(design: np.ndarray, x: float, current: float) -> None:
    from labhil.optimise.field import solve_solenoid

    field = -solve_solenoid(design, x, current, fineness=0.5).force
    circuit = np.interp(x, positions(HOUSING), force_curves(design, current=current)[0])
    assert circuit == pytest.approx(field, rel=0.17)
