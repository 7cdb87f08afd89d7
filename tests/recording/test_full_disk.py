"""A disk that is full: exit status 1, what to do, and nothing half left behind, whatever was to be written.

``RLIMIT_FSIZE`` refuses what a full disk refuses, by another number; ``/dev/full`` is always full.
"""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path

import pytest

from labhil.atomic_file import atomic_file, write_error
from labhil.errors import DiskFailedError, UsageError

RECORDING = Path(__file__).parents[2] / "recordings" / "ball_beam_identify.mcap"
RIG = '[rig]\nkind = "ball_beam"\n'
ROOM = 12_000
# a workbook is put together in a temporary file, which such a limit hits first, in the midst of its package
WRITES = {
    "csv": ("export", str(RECORDING), "-o", "x.csv"),
    "parquet": ("export", str(RECORDING), "-o", "x.parquet"),
    "mat": ("export", str(RECORDING), "-o", "x.mat"),
    "bag": ("export", str(RECORDING), "-o", "x.rosbag2"),
    "import": ("import", "bench.csv", "--rig", "rig.toml", "-o", "x.mcap"),
    "recover": ("recover", str(RECORDING), "-o", "x.mcap"),
    "report": ("report", str(RECORDING), "-o", "x.html"),
}
OFTEN = ("csv", "import")
CODE = (
    "import resource, sys; from labhil.cli import main\n"
    f"resource.setrlimit(resource.RLIMIT_FSIZE, ({ROOM}, {ROOM}))\nmain()"
)


@pytest.mark.extended
@pytest.mark.parametrize(
    "what", [pytest.param(name, marks=() if name in OFTEN else pytest.mark.extended) for name in WRITES]
)
def test_nothing_half_is_left_on_a_full_disk(tmp_path: Path, what: str) -> None:
    rows = "".join(f"{k / 100},{(k * 7919) % 1000 / 999:.12f},{k % 97 / 96:.12f}\n" for k in range(4000))
    (tmp_path / "bench.csv").write_text("t,servo_angle,ball_position\n" + rows)
    (tmp_path / "rig.toml").write_text(RIG)
    before = sorted(path.name for path in tmp_path.iterdir())
    done = subprocess.run(
        [sys.executable, "-P", "-c", CODE, *WRITES[what]],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (1, ""), done.stderr
    assert "File too large" in done.stderr
    assert "x." in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_what_was_there_stays_until_the_new_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text("precious")
    refused = pytest.raises(DiskFailedError, match=r"result.json: the result cannot be written: No space")
    with refused, atomic_file(path, "the result") as draft:
        draft.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert [(found.name, found.read_text()) for found in tmp_path.iterdir()] == [("result.json", "precious")]
    with atomic_file(path) as draft:
        draft.write_text("new")
    assert path.read_text() == "new"


def test_a_full_device_is_written_to_as_it_is_and_stays_a_device() -> None:
    full = Path("/dev/full")
    with pytest.raises(DiskFailedError, match="/dev/full"), atomic_file(full) as place:
        place.write_text("x")
    assert full.is_char_device()


def test_a_path_at_fault_is_wrong_use_and_a_disk_is_not() -> None:
    assert isinstance(write_error(Path("a"), PermissionError(errno.EACCES, "Permission denied")), UsageError)
    assert isinstance(write_error(Path("a"), OSError(errno.EDQUOT, "Quota exceeded")), DiskFailedError)
