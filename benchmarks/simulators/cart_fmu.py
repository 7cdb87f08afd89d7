"""Builds the simulator of ``cart.py`` as an FMU: ``python benchmarks/simulators/cart_fmu.py FOLDER``.

It is the pendulum of ``examples/fmu`` without gravity and drag: a mass that is driven.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "fmu"))
from pendulum_fmu import built

CART = (
    ("position", "output", "continuous", "0", "m", ""),
    ("velocity", "local", "continuous", "0", "m/s", ""),
    ("drive_force", "input", "continuous", "0", "N", ""),
    ("mass", "parameter", "tunable", "20", "kg", 'min="1e-4"'),
    ("gravity", "parameter", "fixed", "0", "N", ""),
    ("drag", "parameter", "fixed", "0", "N.s/m", ""),
    ("width", "parameter", "fixed", "0", "m", ""),
    ("position_start", "parameter", "fixed", "0", "m", ""),
)

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as build:
        made = built(Path(build), version=3, kinds="me", variables=CART)
        print(shutil.copy(made, Path(sys.argv[1] if len(sys.argv) > 1 else ".") / "cart.fmu"))
