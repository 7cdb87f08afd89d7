"""The solenoid's geometry: the five parameters of the optimisation (Table A.2) and the fixed dimensions.

The reference text names the five parameters R, L1, L2, W, θ and their levels, and gives no dimensions of
the rest; its figures are not available. So the meaning of L1 and L2 and every number of the housing are
ours. Lengths along the axis z count from the floor of the pole piece's recess, backwards::

      z<0      0 .. L1        L1 .. L1+W          L1+W ..
    ┌──────────────────────────── coil ────────────────────────────┐
    │ pole     collar        anti-magnetic ring   guide tube       │   wall of thickness ``wall``
    │ piece    ╎ recess ╎ ◄─ gap ─► ╱▔▔ plunger of radius R ▔▔     │
    └──────────╎────────╎───────────╎──────────────────────────────┘
                                    nose: bored, L2 long, its outside coned by θ

- R: radius of the plunger. Pole piece, tube, coil and casing move outwards with it; the cross-section of
  the winding stays.
- L1: depth of the recess, which is the length of the steel collar that the plunger dives into.
- L2: length of the plunger's tubular nose, bored to ``bore_radius``.
- W: width of the anti-magnetic ring between the collar and the guide tube.
- θ: angle of the cone on the outside of the nose, whose front is L2·tan θ narrower than the plunger.

The plunger's position x is 0 when the gap is largest and grows towards the pole piece, as in eq. 4.10.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from labhil.errors import UsageError
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class DesignParameter:
    """A dimension of the design: its symbol and unit in the text, and its five levels in SI."""

    name: str
    symbol: str
    unit: str
    """SI: m or rad."""
    shown_unit: str
    """The text's: mm or °."""
    shown_scale: float
    """SI value times this is the number in the text's unit."""
    levels: tuple[float, ...]


def _millimetres(name: str, symbol: str, *levels: float) -> DesignParameter:
    return DesignParameter(name, symbol, "m", "mm", 1e3, tuple(1e-3 * level for level in levels))


PARAMETERS = (
    _millimetres("plunger_radius", "R", 8.35, 9.35, 9.85, 10.35, 11.35),
    _millimetres("recess_depth", "L1", 2.7, 3.7, 4.2, 4.7, 5.7),
    _millimetres("nose_length", "L2", 4.0, 4.5, 5.0, 5.5, 6.0),
    _millimetres("ring_width", "W", 1.5, 2.0, 2.5, 3.0, 3.5),
    DesignParameter(
        "cone_angle", "θ", "rad", "°", 180 / np.pi, tuple(np.deg2rad(a) for a in (0.0, 4.0, 8.0, 12.0, 16.0))
    ),
)
"""Table A.2."""

LEVELS: FloatArray = np.array([parameter.levels for parameter in PARAMETERS])
"""(5, 5): the levels of each parameter, m and rad."""

LOWER: FloatArray = LEVELS[:, 0].copy()
UPPER: FloatArray = LEVELS[:, -1].copy()
SHOWN: FloatArray = np.array([parameter.shown_scale for parameter in PARAMETERS])

ORIGINAL: FloatArray = np.array([9.35, 4.7, 4.0, 2.5, 0.0]) / SHOWN
"""The original design of Table A.3, m and rad."""

TEXT_OPTIMUM: FloatArray = np.array([10.0, 3.7, 4.0, 2.0, 4.5]) / SHOWN
"""The optimum of Table A.3, m and rad."""


class Housing(NamedTuple):
    """Fixed dimensions, m; all numbers but those of the coil are ours."""

    clearance: float = 0.15e-3
    """Radial gap between plunger and tube (a lining that is not magnetic)."""
    wall: float = 2.0e-3
    """Thickness of the tube's wall, collar and ring alike."""
    bore_radius: float = 4.0e-3
    """Of the nose."""
    residual_gap: float = 1.0e-3
    """Between plunger and recess floor at full travel: the anti-stick disc. Of 0.8 and 1.0 mm the latter
    was taken: the original's largest force (76.5 N by the field solver) is then nearer the text's 78.9 N."""
    travel: float = 5.0e-3
    ahead: float = 12.0e-3
    """From the front flange to the recess floor."""
    behind: float = 24.0e-3
    """From the recess floor to the rear flange."""
    flange: float = 5.0e-3
    """Thickness of both flanges."""
    window: float = 9.0e-3
    """From the tube to the casing: winding, 0.7 mm wire, and its former."""
    casing: float = 3.0e-3
    """Thickness of the casing."""
    plunger_length: float = 32.0e-3
    turns: float = 450.0
    current: float = 2.7
    """A; the text's largest."""


HOUSING = Housing()


def check_designs(designs: FloatArray) -> FloatArray:
    """Return designs as an array (n, 5) of m and rad.

    UsageError for one far outside of Table A.2's bounds.
    """
    table = np.ascontiguousarray(np.atleast_2d(np.asarray(designs, dtype=np.float64)))
    if table.ndim != 2 or table.shape[1] != len(PARAMETERS):
        raise UsageError(f"designs: expected rows of {len(PARAMETERS)} numbers, found shape {table.shape}")
    margin = 1e-9 + 0.2 * (UPPER - LOWER)
    for row in table:
        if not np.all(np.isfinite(row)) or np.any(row < LOWER - margin) or np.any(row > UPPER + margin):
            raise UsageError(
                f"design {design_text(row)}: expected values within Table A.2's bounds, or close by"
            )
    return table


def design_text(design: FloatArray) -> str:
    """Format a design (5,) in the text's units, like ``R 9.35 mm, L1 4.7 mm, …``."""
    return ", ".join(
        f"{p.symbol} {value * p.shown_scale:.4g}{'' if p.shown_unit == '°' else ' '}{p.shown_unit}"
        for p, value in zip(PARAMETERS, design, strict=True)
    )
