"""A run that cannot write its recording: exit status 1, the reason says so, all data so far is readable."""

from __future__ import annotations

import json
import resource
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.recording.reader import read_recording

EXPERIMENT = """
[experiment]
name = "full"
[devices.bench]
plugin = "ball_beam"
address = "twin"
twin = { seed = 1 }
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "hold"
level = 0.02
duration = 300.0
"""
ROOM = 60_000
"""Bytes: some seconds of samples."""


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, in memory, with little room; only who may mount one can test it."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256m", "tmpfs", str(place)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no file system of its own can be mounted here: {error}")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def run(folder: Path, out: Path, limit: Callable[[], None] | None = None) -> subprocess.CompletedProcess[str]:
    (folder / "e.toml").write_text(EXPERIMENT)
    command = [*PATIENT_LABHIL, "run", "e.toml", "--out", str(out), "--json"]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=250, preexec_fn=limit
    )


def refuse_more() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_a_quota_that_is_used_up(tmp_path: Path) -> None:
    done = run(tmp_path, tmp_path, refuse_more)
    assert done.returncode == 1, done.stderr
    assert "the disk failed: [Errno 27] File too large" in json.loads(done.stdout)["reason"]
    assert "Traceback" not in done.stderr
    (part,) = tmp_path.glob("*.mcap.part")
    data = read_recording(part).stream_with("ball_position")
    assert len(data) > 0 and np.array_equal(np.diff(data.seq), np.ones(len(data) - 1))


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_a_disk_that_may_not_be_written(tmp_path: Path, small_disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    done = run(tmp_path, small_disk)
    assert done.returncode == 1, done.stderr
    assert "Read-only file system" in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert not list(small_disk.iterdir())
