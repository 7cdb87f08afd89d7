"""What the screen is made of, without a screen."""

from __future__ import annotations

import json
import queue
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from labhil.campaign.studies.jobs import Jobs
from labhil.campaign.studies.process import Helper
from labhil.campaign.studies.study import Task, free_name
from labhil.signals import Batch, Direction, Signal, Stream
from labhil.tui.recording_library import RecordingLibrary, list_experiments, list_results
from labhil.tui.ring_buffer import RingBuffer, envelope, split_at_gaps
from labhil.tui.stream_watch import StreamWatch
from labhil.tui.ticks import axis_limits, round_step, round_ticks, tick_labels

STREAM = Stream("state", (Signal("x", "m", Direction.OUTPUT),), 100.0)


def batch(first: int, count: int) -> Batch:
    seq = np.arange(first, first + count)
    t_ns = seq * 10_000_000
    return Batch(seq, t_ns, t_ns, seq[:, None].astype(float))


def test_a_ring_gives_the_newest_whatever_came_before() -> None:
    ring = RingBuffer(1, 50)
    for first in range(0, 1000, 7):
        ring.append(batch(first, 7))
        newest = ring.newest(0.2)[2][:, 0]
        expected = np.arange(max(0, first + 6 - 20), first + 7)
        assert np.array_equal(newest, expected)


def test_a_ring_keeps_the_newest_of_more_than_it_holds() -> None:
    ring = RingBuffer(1, 50)
    ring.append(batch(0, 500))
    assert ring.newest(100.0)[2][:, 0].tolist() == list(range(450, 500))


def test_a_peak_of_one_sample_stays_visible() -> None:
    x, y = np.arange(10_000.0), np.zeros(10_000)
    y[7_321] = 5.0
    _, reduced = envelope(x, y, 40)
    assert len(reduced) == 80
    assert reduced.max() == 5.0


def test_the_pen_is_lifted_where_samples_are_missing() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    assert split_at_gaps(t, 0.3) == [slice(0, 3), slice(3, 5)]


@pytest.mark.parametrize("limits", [(-0.15, 0.15), (0.0, 1e-7), (-3.0, 1e6), (99.9, 100.1)])
@pytest.mark.parametrize("most", [1, 2, 3, 6])
def test_ticks_are_at_least_two_at_round_places_within_the_limits(
    limits: tuple[float, float], most: int
) -> None:
    found = round_ticks(*limits, most)
    assert 2 <= len(found) <= 2 * most + 3
    assert limits[0] - 1e-9 * abs(limits[0]) <= found[0] < found[-1] <= limits[1] * (1 + 1e-9)
    assert len(set(tick_labels(found))) == len(found)


def test_limits_contain_the_data_and_survive_none() -> None:
    low, high = axis_limits([np.array([0.31, np.nan, 0.77])])
    assert low <= 0.31 < 0.77 <= high
    assert axis_limits([np.array([np.nan])]) == (-1.0, 1.0)
    assert axis_limits([np.array([5.0, 5.0])])[0] < 5.0
    assert round_step(0.3) == 0.5


def test_a_stream_that_stops_is_silent_and_its_gaps_are_counted() -> None:
    watched = StreamWatch(STREAM, 1.0, {})
    codec = watched.codec
    watched.receive(codec.encode(batch(0, 100)), now=10.0, now_ns=1_000_000_000)
    watched.receive(codec.encode(batch(105, 100)), now=11.0, now_ns=2_050_000_000)
    health = watched.health(11.1)
    assert (health.silent, health.gaps, health.received) == (False, 5, 200)
    assert health.rate == pytest.approx(195 / 2.0)  # of the last two seconds, lost ones not counted in
    assert watched.health(11.9).silent
    assert watched.health(11.9).rate is None


def test_among_messages_that_wait_one_that_is_none_takes_no_other_with_it() -> None:
    watched = StreamWatch(STREAM, 1.0, {})
    messages = watched.codec.encode(batch(0, 10))
    watched.receive([*messages[:4], b"no sample", *messages[4:]], now=10.0, now_ns=1_000_000_000)
    assert len(watched.ring.newest(1.0)[0]) == 10
    assert (watched.received, watched.gaps) == (10, 0)
    assert "expected a message of" in watched.fault


def test_a_folder_lists_recordings_experiments_and_results(folder: Path) -> None:
    (folder / "broken.mcap").write_bytes(b"no recording")
    *_, shelved = RecordingLibrary(folder).scan()
    by_name = {one.path.name: one for one in shelved}
    good = by_name["ball_beam_identify.mcap"]
    assert (good.status, good.rig, good.gaps) == ("done", "ball_beam", 0)
    assert by_name["broken.mcap"].status == "unreadable"
    assert [result.kind for result in list_results(folder)] == ["diagnosis", "fit"]
    assert {file.packaged for file in list_experiments(folder)} == {True}
    assert free_name(folder, "ball_beam_identify", "fit.json").name == "ball_beam_identify-2.fit.json"


def test_a_task_survives_the_way_to_its_process(tmp_path: Path) -> None:
    task = Task(
        "fit", (tmp_path / "a.mcap",), (tmp_path / "b.mcap",), tmp_path / "c.json", ("x",), "pso", 3.0
    )
    assert Task.from_json(json.loads(json.dumps(task.to_json()))) == task


def test_a_study_of_what_is_not_there_fails_with_words(tmp_path: Path) -> None:
    said: list[dict[str, Any]] = []
    task = Task("export", (tmp_path / "nothing.mcap",))
    helper = Helper("a study", "labhil.campaign.studies.study", task.to_json(), said.append)
    deadline = time.monotonic() + 60.0
    while helper.running and time.monotonic() < deadline:
        time.sleep(0.02)
    helper.close()
    assert "nothing.mcap" in next(line["failed"] for line in said if "failed" in line)
    assert said[-1]["ended"] == 2


def test_a_study_that_is_over_holds_nothing_open(tmp_path: Path) -> None:
    said: queue.Queue[tuple[int, dict[str, Any]]] = queue.Queue()
    jobs = Jobs(lambda number, line: said.put((number, line)), time.monotonic)
    before = psutil.Process().num_fds()
    job = jobs.start(Task("export", (tmp_path / "nothing.mcap",)))
    line: dict[str, Any] = {}
    while "ended" not in line:
        number, line = said.get(timeout=60.0)
        jobs.handle_line(number, line)
    assert (job.state, "nothing.mcap" in job.message) == ("failed", True)
    assert psutil.Process().num_fds() == before


@pytest.mark.extended
def test_a_study_that_is_cancelled_leaves_nothing(folder: Path) -> None:
    before = sorted(folder.iterdir())
    said: list[dict[str, Any]] = []
    task = Task("diagnose", (folder / "ball_beam_identify.mcap",))
    helper = Helper("a study", "labhil.campaign.studies.study", task.to_json(), said.append)
    deadline = time.monotonic() + 100.0
    while not any("fitting" in line.get("progress", "") for line in said) and time.monotonic() < deadline:
        time.sleep(0.02)
    helper.close(5.0)
    assert said[-1]["ended"] == 130
    assert sorted(folder.iterdir()) == before
