"""Recordings in which something stands still: refused in words before a fit, undecided for a diagnosis."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

COUNT = 2500
T = np.arange(COUNT) / 100
SINE = np.sin(np.pi * T)
NOISE = np.random.default_rng(1).normal(size=COUNT)

JOINTS = range(6)
STILL_ARM = {f"actual_q_{j}": 0.3 + 0 * T for j in JOINTS} | {f"actual_qd_{j}": 0 * T for j in JOINTS}
ARM = {f"actual_q_{j}": np.sin(T + j) for j in JOINTS} | {f"actual_qd_{j}": np.cos(T + j) for j in JOINTS}
CURRENTS = {f"actual_current_{j}": 0.5 + 0.1 * SINE for j in JOINTS}
NO_CURRENTS = {f"actual_current_{j}": 0.5 + 0 * T for j in JOINTS}

NOTHING = "nothing can be fitted to that"
STILL = {
    "a position that stands": (
        "ball_beam",
        {"servo_angle": 0.3 * SINE, "ball_position": 0.02 + 0 * T},
        ("expected an output that moves", "ball_position at 0.02 m in all", NOTHING),
    ),
    "a position that stands, and no input": (
        "ball_beam",
        {"servo_angle": 0 * T, "ball_position": 0.02 + 0 * T},
        ("ball_position at 0.02 m", NOTHING),
    ),
    "nobody moves it": (
        "ball_beam",
        {"servo_angle": 0.1 + 0 * T, "ball_position": 0.02 + 4e-4 * NOISE},
        ("expected an input that changes", "servo_angle at 0.1", "Excite it and record again"),
    ),
    "a motor at one voltage": (
        "dc_motor",
        {"voltage": 3.0 + 0 * T, "speed": 10 + 0.1 * NOISE, "current": 0.2 + 0.01 * NOISE[::-1]},
        ("expected an input that changes", "voltage at 3"),
    ),
    "a speed that is stuck": (
        "dc_motor",
        {"voltage": SINE, "speed": 3.0 + 0 * T, "current": 0.2 * SINE},
        ("expected readings of speed", "speed at 3 rad/s", "without the column speed"),
    ),
    "a motor that dry friction holds": (
        "dc_motor",
        {"voltage": SINE, "speed": 0 * T, "current": 0.2 * SINE + 0.01 * NOISE},
        ("speed at 0 rad/s", "whether the part only stood still: then drive it beyond break-away"),
    ),
    "a current that is stuck": (
        "dc_motor",
        {"voltage": SINE, "speed": 3.0 * SINE, "current": 0 * T},
        ("expected readings of current", "current at 0 A", "without the column current"),
    ),
    "a plunger that sticks": (
        "solenoid",
        {"coil_current": 1 + SINE, "plunger_position": 0.002 + 0 * T},
        ("plunger_position at 0.002 m", NOTHING),
    ),
    "an axis that stands": (
        "axis",
        {"drive_force": 10 * SINE, "position": 0.1 + 0 * T},
        ("position at 0.1 m", NOTHING),
    ),
    "an arm that stands": (
        "ur5",
        STILL_ARM | CURRENTS,
        ("too little motion for inverse dynamics", "faster than 0.01 rad/s"),
    ),
    "an arm without currents": ("ur5", ARM | NO_CURRENTS, ("actual_current_0 at 0.5 A", NOTHING)),
}


def imported(labhil, folder: Path, rig: str, columns: dict[str, np.ndarray]) -> str:
    table = np.column_stack([T, *columns.values()])
    header = ",".join(("t", *columns))
    np.savetxt(folder / "bench.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    (folder / "rig.toml").write_text(f'[rig]\nkind = "{rig}"\n')
    assert labhil("import", "bench.csv", "--rig", "rig.toml", "-o", "bench.mcap").status == 0
    return "bench.mcap"


@pytest.mark.parametrize("case", STILL)
def test_a_fit_of_what_stands_still_is_refused(labhil, tmp_path: Path, case: str) -> None:
    rig, columns, told = STILL[case]
    message = labhil("fit", imported(labhil, tmp_path, rig, columns), "--json", "fit.json").refused()
    assert "bench.mcap: " in message
    for words in told:
        assert words in message
    assert not (tmp_path / "fit.json").exists()


@pytest.mark.extended
@pytest.mark.parametrize("case", ["a position that stands", "a position that stands, and no input"])
def test_a_diagnosis_of_what_stands_still_says_that_it_cannot_tell(labhil, tmp_path: Path, case: str) -> None:
    rig, columns, _ = STILL[case]
    recording = imported(labhil, tmp_path, rig, columns)
    done = labhil("diagnose", recording, "--json", "d.json")
    assert done.status == 0, done
    assert "hardly moves" in done.out
    assert "R² – → –" in done.out
    found = json.loads((tmp_path / "d.json").read_text())
    assert found["verdict"] in ("not_decidable", "data_fault")
    assert found["missing"] == []
    assert found["improvement"]["r2_before"] is None


@pytest.mark.extended
def test_what_moves_by_itself_is_fitted_and_said(labhil, tmp_path: Path) -> None:
    """A motor that coasts down with its leads shorted: the input never changes, and yet it tells."""
    columns = {"voltage": 0 * T, "speed": 30 * np.exp(-0.7 * T) + 0.01 * NOISE}
    recording = imported(labhil, tmp_path, "dc_motor", columns)
    done = labhil("fit", recording, "--terms", "viscous_friction", "--holdout", "0")
    assert done.status == 0, done.err
    assert "No input changes (voltage): only what the rig does by itself can be learnt." in done.out
