"""Samples that come in bursts stand in the file at their own times, and what they are stands beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from labhil.codec import stamps_of
from labhil.recording.log_times import LogTimes
from labhil.recording.reader import read_recording
from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch, Direction, IntArray, Signal, Stream

MS = 1_000_000
BEGIN = 1_790_000_000_000 * MS
STREAM = Stream(
    "state",
    (
        Signal("voltage", "V", Direction.INPUT),
        Signal("speed", "rad/s", Direction.OUTPUT, description="of the shaft"),
    ),
    1000.0,
)


def bursts(count: int, size: int, *, drift: float = 0.0, delay_ns: int = MS) -> tuple[IntArray, IntArray]:
    """Stamps of samples every ms, ``size`` of them sent at once: acquisition and device."""
    number = np.arange(count * size)
    taken = BEGIN + number * MS
    acquired = np.repeat(taken[size - 1 :: size] + delay_ns, size)
    return acquired, 5 * MS + np.rint(number * MS * (1.0 + drift)).astype(np.int64)


def in_writes(times: LogTimes, acquired: IntArray, device: IntArray, size: int) -> IntArray:
    parts = [times.of(acquired[k : k + size], device[k : k + size]) for k in range(0, len(device), size)]
    return np.concatenate(parts)


def test_samples_of_a_burst_stand_where_they_were_taken() -> None:
    acquired, device = bursts(100, 36)
    log = in_writes(LogTimes(), acquired, device, 36)
    assert (np.diff(log) == MS).all()
    assert (log[35::36] == acquired[35::36]).all()


def test_a_burst_that_is_written_in_parts_is_no_different_after_the_first() -> None:
    acquired, device = bursts(100, 36)
    log = in_writes(LogTimes(), acquired, device, 25)
    assert (log <= acquired).all()
    assert (np.diff(log) >= 0).all()
    assert (np.diff(log[72:]) == MS).all()


@pytest.mark.parametrize("drift", [0.005, -0.005, 1e-4])
def test_a_clock_that_runs_wrong_moves_samples_by_no_more_than_it_is_wrong_within_two_windows(
    drift: float,
) -> None:
    acquired, device = bursts(400, 36, drift=drift)
    log = in_writes(LogTimes(), acquired, device, 36)
    taken = BEGIN + np.arange(len(log)) * MS
    assert (np.diff(log) > 0).all()
    assert np.abs(log - taken - MS).max() <= abs(drift) * 2.1e9 + 2


def test_after_a_restart_of_the_device_times_go_on() -> None:
    acquired, device = bursts(20, 10)
    again, fresh = bursts(20, 10)
    later = again + (acquired[-1] - acquired[0]) + 300 * MS
    times = LogTimes()
    log = np.concatenate([in_writes(times, acquired, device, 10), in_writes(times, later, fresh, 10)])
    assert (np.diff(log) > 0).all()
    assert abs(int(log[-1]) - int(later[-1])) < MS


def test_a_world_that_runs_faster_is_drawn_in_the_time_of_the_host() -> None:
    acquired, device = bursts(50, 10)
    log = in_writes(LogTimes(speed=4.0), acquired, 4 * device, 10)
    assert (np.diff(log) == MS).all()


def test_a_table_keeps_its_times() -> None:
    stamps = BEGIN + np.array([0, 10, 20, 20, 30, 5000, 5010]) * MS
    assert LogTimes().of(stamps, stamps).tolist() == stamps.tolist()


stamp = st.integers(0, 2**62)


@settings(deadline=None, max_examples=300)
@given(
    st.lists(st.tuples(stamp, stamp), min_size=1, max_size=30), st.sampled_from([1.0, 3.0, 0.01]), st.data()
)
def test_whatever_a_device_stamps_times_are_in_order_and_in_range(
    stamps: list[tuple[int, int]], speed: float, data: st.DataObject
) -> None:
    acquired, device = (np.array(column, dtype=np.int64) for column in zip(*stamps, strict=True))
    acquired.sort()
    size = data.draw(st.integers(1, len(stamps)))
    log = in_writes(LogTimes(speed), acquired, device, size)
    assert (np.diff(log) >= 0).all()
    assert (log >= 0).all()
    assert (log <= acquired + len(stamps)).all()


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "bursts.mcap"
    acquired, device = bursts(50, 20)
    with RecordingWriter(path) as writer:
        channel = writer.add_stream("bench", STREAM, {"serial": "7"})
        values = np.column_stack([np.sin(device * 1e-9), np.cos(device * 1e-9)])
        for k in range(0, len(device), 20):
            part = slice(k, k + 20)
            writer.write(channel, Batch(np.arange(k, k + 20), acquired[part], device[part], values[part]))
        writer.event("bench", BEGIN + 5, {"t_ns": BEGIN + 5, "kind": "safe", "message": "at rest"})
        writer.event("recorder", BEGIN + 6, {"streams": {}, "queued": 0}, topic="status")
    return path


def messages(path: Path) -> list[Any]:
    with path.open("rb") as file:
        return list(make_reader(file).iter_messages())


def test_what_came_in_stays_as_it_was_beside_the_times_of_the_file(recording: Path) -> None:
    samples = [(m, stamps_of([m.data])[0]) for _, c, m in messages(recording) if c.topic == "/bench/state"]
    assert len({m.log_time for m, _ in samples}) == len(samples) == 1000
    assert [m.publish_time for m, _ in samples] == [m.log_time for m, _ in samples]
    acquired, device = bursts(50, 20)
    assert [int(own[1]) for _, own in samples] == acquired.tolist()
    data = read_recording(recording).streams[0]
    assert data.t_acq_ns.tolist() == acquired.tolist()
    assert data.t_hw_ns.tolist() == device.tolist()


def test_units_stand_in_the_channel_and_beside_each_field(recording: Path) -> None:
    schema, channel, _ = next(row for row in messages(recording) if row[1].topic == "/bench/state")
    assert channel.metadata["labhil.unit.voltage"] == "V"
    assert channel.metadata["labhil.unit.speed"] == "rad/s"
    (file,) = FileDescriptorSet.FromString(schema.data).file
    notes = {tuple(place.path): place.leading_comments for place in file.source_code_info.location}
    names = [field.name for field in file.message_type[0].field]
    assert notes[4, 0, 2, names.index("speed")] == " rad/s; of the shaft; output\n"
    assert notes[4, 0, 2, names.index("t_acq_ns")].startswith(" ns;")


def test_events_have_a_schema_that_names_their_fields_and_a_time(recording: Path) -> None:
    found = {channel.topic: (schema, message) for schema, channel, message in messages(recording)}
    for topic in ("/bench/event", "/recorder/status"):
        schema, message = found[topic]
        told, body = json.loads(schema.data), json.loads(message.data)
        assert set(body) <= set(told["properties"])
        assert body["timestamp"] == {"sec": BEGIN // 10**9, "nsec": BEGIN % 10**9 + message.log_time - BEGIN}
    bodies = [event.body for event in read_recording(recording).events]
    assert bodies == [
        {"t_ns": BEGIN + 5, "kind": "safe", "message": "at rest"},
        {"streams": {}, "queued": 0},
    ]
