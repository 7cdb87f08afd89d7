"""A magnet's measured forces in the place of the stated ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from labhil.errors import UsageError
from labhil.plants.solenoid_world import FORCE_MAP, STROKE

COLUMNS = ("coil_current", "plunger_position", "magnetic_force")


def force_map_of(path: Path) -> Mapping[str, float]:
    """The plant's ``force_map_…`` numbers for a CSV file.

    Its columns are coil_current (A), plunger_position (m) and magnetic_force (N). The numbers are a
    polynomial of third order, without force where there is no current, by least squares. UsageError
    when the file cannot be read, or does not determine the polynomial.
    """
    try:
        header = [name.strip() for name in path.read_text(encoding="utf-8").split("\n", 1)[0].split(",")]
        places = [header.index(name) for name in COLUMNS]
        i, x, force = np.loadtxt(path, delimiter=",", skiprows=1, usecols=places, ndmin=2).T
    except (OSError, ValueError) as error:
        expected = ", ".join(COLUMNS)
        raise UsageError(f"{path}: expected a CSV file with the columns {expected}: {error}") from error
    powers = [(int(name[-2]), int(name[-1])) for name in FORCE_MAP]
    columns = np.column_stack([i**a * (x / STROKE) ** b for a, b in powers])
    few = len(force) < len(powers) or not np.all(np.isfinite([i, x, force]))
    if few or np.linalg.matrix_rank(columns) < len(powers):
        raise UsageError(
            f"{path}: expected finite forces at three currents and three positions at least, to determine"
            f" {len(powers)} numbers; found {len(force)} rows that do not"
        )
    factors, *_ = np.linalg.lstsq(columns, force, rcond=None)
    return dict(zip(FORCE_MAP, factors.tolist(), strict=True))
