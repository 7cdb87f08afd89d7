"""What we read is what programs read that share no code with us: @mcap/core with protobufjs, and rerun."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from labhil.recording import RecordingWriter, import_table, read_recording, write_import
from labhil.recording.recover import recover
from labhil.rig import parse_rig
from labhil.signals import Batch, Direction, Signal, Stream

HERE = Path(__file__).parent
SHIPPED = HERE.parents[1] / "recordings"

pytestmark = [pytest.mark.extended, pytest.mark.timeout(600)]


@pytest.fixture(scope="session")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the reader for node and its packages; skips where they cannot be had."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("node and npm are not here: nothing to read with")
    folder = tmp_path_factory.mktemp("independent_reader")
    for file in (HERE / "independent_reader").iterdir():
        shutil.copy(file, folder)
    command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    except subprocess.TimeoutExpired:
        pytest.skip("npm did not install @mcap/core within 300 s")
    if done.returncode:
        pytest.skip(f"npm could not install @mcap/core: {done.stderr.strip().splitlines()[-1:]}")
    return folder


def recordings(folder: Path) -> list[Path]:
    """A shipped recording as it is, the same recovered from a cut, and an imported table with vectors."""
    shipped = SHIPPED / "ball_beam_test.mcap"
    (folder / "cut.mcap").write_bytes(shipped.read_bytes()[:-9000])
    recover(folder / "cut.mcap", folder / "recovered.mcap")
    names = [f"{name}_{joint}" for name in ("actual_q", "actual_qd", "actual_current") for joint in range(6)]
    rows = [[k / 500, *(np.sin(k / (c + 3)) for c in range(18))] for k in range(700)]
    text = "\n".join(" ".join(map(repr, map(float, row))) for row in rows)
    (folder / "arm.txt").write_text(" ".join(["timestamp", *names]) + "\n" + text + "\n")
    rig = parse_rig('[rig]\nkind = "ur5"\n', folder / "rig.toml")
    write_import(import_table(folder / "arm.txt", rig), folder / "arm.mcap")
    return [shipped, folder / "recovered.mcap", folder / "arm.mcap"]


def test_counts_times_and_values_are_those_of_another_reader(reader: Path, tmp_path: Path) -> None:
    for path in recordings(tmp_path):
        done = subprocess.run(
            ["node", "read.mjs", path], cwd=reader, capture_output=True, text=True, check=True, timeout=120
        )
        theirs = json.loads(done.stdout)
        ours = read_recording(path)
        assert ours.streams
        for data in ours.streams:
            topic = theirs.pop(f"/{data.device}/{data.stream.name}")
            assert topic["count"] == len(data) > 100
            for stamps in (topic["logTimes"], topic["publishTimes"], topic["fields"]["t_acq_ns"]):
                assert list(map(int, stamps)) == data.t_acq_ns.tolist()
            assert list(map(int, topic["fields"]["t_hw_ns"])) == data.t_hw_ns.tolist()
            assert list(map(int, topic["fields"]["seq"])) == topic["sequences"] == data.seq.tolist()
            for name in data.stream.names():
                assert topic["fields"][name] == data[name].tolist(), (path, name)
        events: dict[str, int] = {}
        for event in ours.events:
            events[f"/{event.device}/{event.topic}"] = events.get(f"/{event.device}/{event.topic}", 0) + 1
        assert {topic: found["count"] for topic, found in theirs.items()} == events


def burst(folder: Path) -> Path:
    """A recording of a device that sends twenty samples at once, a millisecond apart by its own clock."""
    stream = Stream("state", (Signal("speed", "rad/s", Direction.OUTPUT),), 1000.0)
    number = np.arange(1000)
    device = number * 1_000_000
    acquired = 1_790_000_000_000_000_000 + np.repeat(device[19::20], 20)
    with RecordingWriter(folder / "burst.mcap") as writer:
        channel = writer.add_stream("motor", stream)
        for k in range(0, 1000, 20):
            rows = slice(k, k + 20)
            values = np.sin(number[rows, None] / 9.0)
            writer.write(channel, Batch(number[rows], acquired[rows], device[rows], values))
    return folder / "burst.mcap"


def test_samples_of_a_burst_have_times_of_their_own_in_another_reader(reader: Path, tmp_path: Path) -> None:
    path = burst(tmp_path)
    done = subprocess.run(
        ["node", "read.mjs", path], cwd=reader, capture_output=True, text=True, check=True, timeout=120
    )
    topic = json.loads(done.stdout)["/motor/state"]
    times = np.array(list(map(int, topic["logTimes"])))
    assert topic["publishTimes"] == topic["logTimes"]
    assert (np.diff(times) == 1_000_000).all()
    assert len(set(topic["fields"]["t_acq_ns"])) == 50


def test_samples_of_a_burst_have_times_of_their_own_in_rerun(tmp_path: Path) -> None:
    rerun = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: pip install rerun-sdk")
    stamps: list[int] = []
    for chunk in rerun.McapReader(str(burst(tmp_path))).stream():
        batch = chunk.to_record_batch()
        if not chunk.is_static and any(name.endswith(":message") for name in batch.schema.names):
            stamps += batch.column("message_log_time").cast("int64").to_pylist()
    assert (np.diff(sorted(stamps)) == 1_000_000).all()
    assert len(stamps) == 1000


def test_rerun_finds_the_fields_that_it_would_plot(tmp_path: Path) -> None:
    """Rerun is not among the packages of the tests, being 170 MB: ``pip install rerun-sdk`` first."""
    rerun = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: pip install rerun-sdk")
    for path in recordings(tmp_path):
        found: dict[str, list[tuple[int, dict[str, object]]]] = {}
        for chunk in rerun.McapReader(str(path)).stream():
            batch = chunk.to_record_batch()
            columns = [name for name in batch.schema.names if name.endswith(":message")]
            if chunk.is_static or not columns:
                continue
            stamps = batch.column("message_log_time").cast("int64").to_pylist()
            samples = [sample for (sample,) in batch.column(columns[0]).to_pylist()]
            found.setdefault(str(chunk.entity_path), []).extend(zip(stamps, samples, strict=True))
        for data in read_recording(path).streams:
            rows = sorted(found[f"/{data.device}/{data.stream.name}"], key=lambda row: row[1]["seq"])
            assert [stamp for stamp, _ in rows] == data.t_acq_ns.tolist()
            assert [sample["seq"] for _, sample in rows] == data.seq.tolist()
            for name in data.stream.names():
                assert [sample[name] for _, sample in rows] == data[name].tolist(), (path, name)
