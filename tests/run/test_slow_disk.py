"""A disk that is slow: nothing is lost or each loss counted, a run ends in safety, and the reason says so.

``measure_slow_disk.py`` in short needs root; without that, a recorder whose disk takes its time.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labhil.bus.publish import StreamPublisher
from labhil.bus.session import Bus, open_bus
from labhil.errors import RecordingFailedError
from labhil.recording.reader import read_recording
from labhil.service.recorder import Recorder
from labhil.signals import Batch, Direction, Signal, Stream

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))

PATIENCE = 60.0
STREAM = Stream("state", (Signal("ball_position", "m", Direction.OUTPUT),), 100.0)


class SlowDisk:
    """Holds up what forces a file to the disk, as long as it is to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seconds = 0.0
        self.slow_writes = 0
        self._real = os.fdatasync
        monkeypatch.setattr(os, "fdatasync", self._force)

    def _force(self, file: int) -> None:
        seconds = self.seconds
        time.sleep(seconds)
        self._real(file)
        self.slow_writes += seconds > 0.0


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> SlowDisk:
    return SlowDisk(monkeypatch)


@pytest.fixture
def bus() -> Iterator[Bus]:
    with open_bus() as opened:
        yield opened


def batch(first: int, count: int) -> Batch:
    seq = np.arange(first, first + count, dtype=np.int64)
    return Batch(seq, 10**18 + seq * 10**7, seq * 10**7, seq[:, None] * 1.0)


def wait_for(condition: Any) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def samples(recorder: Recorder) -> int:
    return sum(stream.samples for stream in recorder.summary().streams)


def test_a_slow_disk_loses_nothing_and_is_called_slow(bus: Bus, disk: SlowDisk, tmp_path: Path) -> None:
    with Recorder(bus, tmp_path / "a.mcap", slow_flush=0.3) as recorder:
        with StreamPublisher(bus, "bench", STREAM) as publisher:
            publisher.put(batch(0, 100))
            wait_for(lambda: samples(recorder) == 100)
            disk.seconds = 0.5
            for first in range(100, 1000, 100):
                publisher.put(batch(first, 100))
            wait_for(lambda: samples(recorder) == 1000 and disk.slow_writes > 0)
            disk.seconds = 0.0
        recorder.check()
        summary = recorder.finish()
    assert [stream.gaps for stream in summary.streams] == [0]
    (warning,) = [text for text in summary.warnings if "disk" in text]
    assert (
        warning.startswith("the disk is slow: one forced write took up to 0.")
        and "nothing is lost" in warning
    )
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.complete and len(recording.streams[0]) == 1000
    assert "slow_disk" in {event.body.get("kind") for event in recording.events}


def test_a_disk_that_is_too_slow_ends_the_recording_with_all_that_waits(
    bus: Bus, disk: SlowDisk, tmp_path: Path
) -> None:
    # 100 samples take 3 kB or more
    with (
        pytest.raises(RecordingFailedError, match=r"the disk is too slow: .* MB wait to be written"),
        Recorder(bus, tmp_path / "a.mcap", max_backlog=20_000) as recorder,
        StreamPublisher(bus, "bench", STREAM) as publisher,
    ):
        publisher.put(batch(0, 100))
        wait_for(lambda: samples(recorder) == 100)
        disk.seconds = 1.0
        first = 100
        while True:
            publisher.put(batch(first, 100))
            first += 100
            time.sleep(0.05)
            recorder.check()
            assert first < 100_000
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.complete
    data = recording.streams[0]
    assert data.seq[0] == 0 and int(data.seq[-1]) + 1 - len(data) == data.lost
    assert "too slow" in recording.metadata["end"]["reason"]


@pytest.mark.extended
@pytest.mark.timeout(400)
def test_a_run_on_a_disk_that_is_too_slow_ends_in_safety(monkeypatch: pytest.MonkeyPatch) -> None:
    import measure_slow_disk
    from kill_trials import SAMPLING
    from measure_safety import twin_behind_a_relay

    monkeypatch.setattr(measure_slow_disk, "MOST", 500_000)
    try:
        with measure_slow_disk.slow_disk() as disk, twin_behind_a_relay("solenoid", SAMPLING) as relay:
            trial = measure_slow_disk.run_ended(disk, relay, 20_000)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no disk can be slowed down here: {error}")
    assert (trial["exit_status"], trial["device_safe"], trial["complete"]) == (1, True, True), trial
    assert "the disk is too slow" in trial["said"] and trial["lost"] == 0
