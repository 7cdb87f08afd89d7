"""The magnetisation curve of the solenoid's steel, as one smooth formula.

The reference text shows a curve of 11SMN30 steel (Figure A.1) without numbers. Ours is Fröhlich's formula
on top of vacuum, with values of the kind that a free-cutting steel has::

    B(H) = μ₀·H + J_s·H / (H₀ + |H|)

It saturates at the polarisation J_s and has half of that at H = H₀. Circuit and field solver both need
H at a given B, the positive root of a quadratic equation.
"""

from __future__ import annotations

from math import log1p, sqrt
from typing import NamedTuple

import numpy as np

from labhil.compiled import compiled
from labhil.signals import FloatArray

MU0 = 4e-7 * np.pi
SMALL = 1e-3
"""H/H₀ below which t − log(1 + t) is a series, since the difference would lose its digits."""


class Steel(NamedTuple):
    """A steel's curve: ``saturation`` J_s in T, ``half_field`` H₀ in A/m, both positive."""

    saturation: float
    half_field: float


FREE_CUTTING = Steel(1.85, 700.0)
"""Our values for 11SMN30: 1.09 T at 1 kA/m, 1.63 T at 5 kA/m, 1.74 T at 10 kA/m."""


def flux_density(H: FloatArray, steel: Steel) -> FloatArray:
    """Return B (T) at field strengths H (A/m) of any sign and shape."""
    return MU0 * H + steel.saturation * H / (steel.half_field + np.abs(H))


@compiled
def magnetisation(B: float, steel: Steel) -> tuple[float, float, float]:
    """Return H (A/m), dH/dB (A/(m·T)) and ∫ H dB (J/m³) at a flux density B ≥ 0 in T."""
    d = B - steel.saturation - MU0 * steel.half_field
    root = sqrt(d * d + 4.0 * MU0 * steel.half_field * B)
    # Two forms of one root: each where it subtracts no numbers that are nearly equal.
    H = (d + root) / (2.0 * MU0) if d > 0.0 else 2.0 * steel.half_field * B / (root - d)
    slope = 1.0 / (MU0 + steel.saturation * steel.half_field / (steel.half_field + H) ** 2)
    t = H / steel.half_field
    excess = t - log1p(t) if t > SMALL else t * t * (0.5 - t * (1.0 / 3.0 - t * (0.25 - 0.2 * t)))
    return H, slope, H * B - 0.5 * MU0 * H * H - steel.saturation * steel.half_field * excess


def magnetisation_all(B: FloatArray, steel: Steel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the values of :func:`magnetisation` for flux densities B ≥ 0 of any shape."""
    J, H0 = steel
    d = B - J - MU0 * H0
    root = np.sqrt(d * d + 4.0 * MU0 * H0 * B)
    H = np.where(d > 0.0, (d + root) / (2.0 * MU0), 2.0 * H0 * B / (root - np.minimum(d, 0.0)))
    slope = 1.0 / (MU0 + J * H0 / (H0 + H) ** 2)
    t = H / H0
    excess = np.where(t > SMALL, t - np.log1p(t), t * t * (0.5 - t * (1.0 / 3.0 - t * (0.25 - 0.2 * t))))
    return H, slope, H * B - 0.5 * MU0 * H * H - J * H0 * excess
