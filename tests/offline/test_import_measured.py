"""Every measured recording that is supplied becomes a recording of ours: rows, what was dropped, rates."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from labhil.recording import import_table, read_recording, write_import
from labhil.rig import load_rig

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("LABHIL_DATA") or ROOT.parent / "shared" / "data")
RIGS = (Path(__file__).parent / "rigs", ROOT / "docs" / "measured")

pytestmark = [pytest.mark.extended, pytest.mark.timeout(300)]

ARM = "actual_q actual_qd actual_current target_current target_moment"
RTDE = "actual_q actual_qd target_qdd actual_current target_q target_qd target_current"
FULL = (
    "actual_q actual_qd target_qdd actual_current joint_temperatures target_q target_qd target_current "
    "target_moment actual_main_voltage"
)

TABLES = [
    # file, rig file, rows, dropped by reason, duration s, median rate Hz, signals
    ("arm_ur10e/ur-20_01_17-ptp_10_points.csv", "ur10e.toml", 5347, {}, 57.132, 100.0, ARM),
    ("arm_ur10e/ur-20_01_22-joint_1.csv", "ur10e.toml", 5889, {}, 62.908, 100.0, ARM),
    ("arm_ur10e/ur-20_02_10-30sec_12harm.csv", "ur10e.toml", 3691, {}, 39.310, 100.0, ARM),
    ("arm_ur10e/ur-20_02_12-40sec_12harm.csv", "ur10e.toml", 4639, {}, 49.430, 100.0, ARM),
    ("arm_ur10e/ur-20_02_19_14harm50sec.csv", "ur10e.toml", 5375, {}, 56.388, 100.0, ARM),
    ("arm_ur10e/ur-20_02_19_14harm50secLoad.csv", "ur10e.toml", 5307, {}, 55.760, 100.0, ARM),
    (
        *("arm_ur10e/ur-20_02_19_15harm50secLoad.csv", "ur10e.toml", 6107, {"field_count": 1, "time": 9}),
        *(64.456, 100.0, ARM),
    ),
    ("arm_ur3e_rtde/wave_currentData_100v_40a.csv", "ur3e.toml", 6887, {}, 55.776, 125.0, RTDE),
    ("arm_ur3e_rtde/rtde_full_record.xlsx", "rtde_full_record.toml", 888, {}, 35.480, 25.0, FULL),
    ("axis_emps/DATA_EMPS.mat", "emps.toml", 24841, {}, 24.840, 1000.0, "drive_force position"),
    ("ball_beam_daisy/ballbeam.dat", "daisy.toml", 1000, {}, 99.900, 10.0, "beam_angle ball_position"),
    ("dc_motor_dead_zone/run_minimal.csv", "dc_motor.toml", 6601, {}, 66.000, 100.0, "voltage speed"),
]


@pytest.mark.parametrize(("file", "rig", "rows", "dropped", "duration", "rate", "signals"), TABLES)
def test_it_is_imported(
    tmp_path: Path,
    file: str,
    rig: str,
    rows: int,
    dropped: dict[str, int],
    duration: float,
    rate: float,
    signals: str,
) -> None:
    source = DATA / file
    if not source.is_file():
        pytest.skip(f"measured data are not here: {source} (set LABHIL_DATA to their folder)")
    rig_file = next(folder / rig for folder in RIGS if (folder / rig).is_file())
    table = import_table(source, load_rig(rig_file))
    assert table.rows == rows
    assert {reason: count for reason, count in table.dropped.items() if count} == dropped
    assert len(table) == rows - sum(dropped.values())
    assert table.t[-1] == pytest.approx(duration, abs=5e-4)
    assert table.stream.rate == pytest.approx(rate, rel=1e-3)
    assert table.stream.names() == tuple(signals.split())
    recording = read_recording(write_import(table, tmp_path / "rec.mcap"))
    (data,) = recording.streams
    assert np.array_equal(data.values, table.values)
    assert data.t == pytest.approx(table.t, abs=1e-9)
    assert data.lost == int(np.diff(table.row).sum()) - len(table) + 1


def test_every_supplied_recording_is_in_the_table() -> None:
    if not DATA.is_dir():
        pytest.skip(f"measured data are not here: {DATA} (set LABHIL_DATA to their folder)")
    no_recordings = {"ur3e_dh.csv", "ur5e_robot_calibration_summary.txt", "README.md"}
    supplied = {
        str(path.relative_to(DATA))
        for path in DATA.rglob("*")
        if path.is_file() and path.name not in no_recordings
    }
    assert supplied == {file for file, *_ in TABLES}
