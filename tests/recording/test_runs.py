"""Merged recordings: order, exact copies, and several runs of one stream; every command sees the same."""

import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from labhil.analysis.rig_choice import rig_of
from labhil.codec import Codec
from labhil.errors import RecordingError
from labhil.recording import RecordingWriter, read_recording
from labhil.recording.recover import recover
from labhil.recording.runs import MixedRunsError, order_samples
from labhil.signals import Batch

sys.path.insert(0, str(Path(__file__).parent))
from samples_of_a_bench import RIG, START_NS, STATE, batch

CODEC = Codec(STATE)
LATER_NS = 3600 * 10**9


def another_boot(count):
    """Another run: an hour later, numbers and the device's clock from the start, other values."""
    one = batch(0, count)
    return Batch(one.seq, one.t_acq_ns + LATER_NS, one.t_hw_ns, one.values + 100.0)


def merged(path, *channels, event_at=(), rigs=(RIG,)):
    """A file with a channel of the topic for each list of samples, written in their order."""
    with RecordingWriter(path.with_name("pattern.mcap")) as pattern:
        pattern.add_stream("bench", STATE)
    with path.with_name("pattern.mcap").open("rb") as file:
        metadata = next(iter(make_reader(file).get_summary().channels.values())).metadata
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000)
        writer.start()
        for rig in rigs:
            writer.add_attachment(0, 0, "rig.toml", "application/toml", rig.encode())
        schema = writer.register_schema(CODEC.schema_name, "protobuf", CODEC.descriptor_set())
        for number, samples in enumerate(channels):
            told = {**metadata, "source": str(number)}
            channel = writer.register_channel("/bench/state", "protobuf", schema, told)
            for payload, t_ns in zip(CODEC.encode(samples), samples.t_acq_ns.tolist(), strict=True):
                writer.add_message(channel, t_ns, payload, t_ns)
        events = writer.register_channel("/bench/event", "json", 0, {"device": "bench"})
        for t_ns in event_at:
            writer.add_message(events, t_ns, b'{"text": "here"}', t_ns)
        writer.finish()
    path.with_name("pattern.mcap").unlink()
    return path


def rows(samples, places):
    return Batch(*(getattr(samples, name)[places] for name in ("seq", "t_acq_ns", "t_hw_ns", "values")))


def joined(*batches):
    return Batch.joined(batches, STATE.width)


def same(data, expected):
    assert data.seq.tolist() == expected.seq.tolist()
    assert np.array_equal(data.values, expected.values)


SHUFFLED = np.random.default_rng(4).permutation(300)
TWICE = np.sort(np.concatenate([np.arange(300), np.arange(100, 120)]))
COPIED_BEHIND = np.concatenate([np.arange(300), np.arange(50, 90)])
ONE_LATE = np.concatenate([np.arange(0, 200), np.arange(201, 260), [200], np.arange(260, 300)])


@pytest.mark.parametrize(
    ("places", "copies", "moved"),
    [
        (np.arange(300), 0, 0),
        (ONE_LATE, 0, 1),
        (TWICE, 20, 0),
        (COPIED_BEHIND, 40, 0),
        (SHUFFLED, 0, int(np.count_nonzero(np.maximum.accumulate(SHUFFLED) > SHUFFLED))),
    ],
)
def test_samples_are_read_and_recovered_in_order_and_once(tmp_path, places, copies, moved):
    path = merged(tmp_path / "a.mcap", rows(batch(0, 300), places))
    saved = recover(path, tmp_path / "saved.mcap")
    assert (saved.copies, saved.moved) == (copies, moved)
    assert not any("lost" in line and "nothing" not in line for line in saved.lines())
    for recording in (read_recording(path), read_recording(tmp_path / "saved.mcap")):
        data = recording.stream_with("ball_position")
        same(data, batch(0, 300))
        assert data.lost == 0
        assert (np.diff(data.t) > 0).all()
    found = read_recording(path)
    counts = (found.streams[0].copies, found.streams[0].moved)
    assert counts == (copies, moved)
    assert len(found.warnings()) == np.count_nonzero(counts)
    assert read_recording(tmp_path / "saved.mcap").warnings() == []


RUNS = {
    "two channels": (batch(0, 300), another_boot(200)),
    "two channels, the later first": (another_boot(200), batch(0, 300)),
    "one channel": (joined(batch(0, 300), another_boot(200)),),
    "one channel, the later first": (joined(another_boot(200), batch(0, 300)),),
    "two channels, each with a late sample": (rows(batch(0, 300), ONE_LATE), another_boot(200)),
}


@pytest.mark.parametrize("case", RUNS)
def test_two_runs_are_refused_until_one_is_chosen(tmp_path, case):
    path = merged(tmp_path / "a.mcap", *RUNS[case], event_at=(START_NS, START_NS + LATER_NS + 1))
    with pytest.raises(
        RecordingError, match=r"one run of /bench/state, found 2: 1: 300 samples.* 2: 200 samples.*--run N"
    ):
        read_recording(path)
    first, second = read_recording(path, 1), read_recording(path, 2)
    same(first.streams[0], batch(0, 300))
    same(second.streams[0], another_boot(200))
    assert len(first.events) == len(second.events) == 1
    assert second.events[0].t == pytest.approx(1e-9)
    with pytest.raises(RecordingError, match=r"run 3: expected a number from 1 to 2"):
        read_recording(path, 3)


def test_a_run_is_asked_for_only_where_there_are_several(tmp_path):
    path = merged(tmp_path / "a.mcap", batch(0, 300))
    same(read_recording(path, 1).streams[0], batch(0, 300))
    with pytest.raises(RecordingError, match=r"run 2: expected a number from 1 to 1, found one run"):
        read_recording(path, 2)


def test_channels_that_share_samples_are_one_run(tmp_path):
    """A recording merged with a copy of itself, or with the next one that rolled on a few samples before."""
    path = merged(tmp_path / "a.mcap", batch(0, 300), batch(290, 200), batch(0, 300))
    data = read_recording(path).stream_with("ball_position")
    same(data, batch(0, 490))
    assert data.copies == 310


def test_a_host_clock_that_was_set_is_no_other_run():
    n = np.arange(500)
    t_acq = n * 10**7 - np.where(n > 250, 10**9, 0)
    (whole,) = order_samples(n, t_acq, n * 10**7)
    assert whole.tolist() == n.tolist()
    late = ONE_LATE[:300]
    (whole,) = order_samples(late, t_acq[late], late * 10**7)
    assert late[whole].tolist() == list(range(300))


def test_runs_that_are_shuffled_into_one_channel_are_refused(tmp_path):
    one, other = batch(0, 300), batch(0, 300)
    both = joined(one, Batch(other.seq, other.t_acq_ns, other.t_hw_ns, other.values + 1.0))
    mixed = rows(both, np.arange(600).reshape(2, 300).T.ravel())
    with pytest.raises(MixedRunsError):
        order_samples(mixed.seq, mixed.t_acq_ns, mixed.t_hw_ns)
    path = merged(tmp_path / "a.mcap", mixed)
    with pytest.raises(RecordingError, match=r"/bench/state: .*found 300 of 600 .*nothing tells them apart"):
        read_recording(path)
    assert any("left unchanged" in line for line in recover(path, tmp_path / "b.mcap").lines())


def test_of_rig_files_that_differ_none_is_taken_unless_one_is_given(tmp_path):
    path = merged(tmp_path / "a.mcap", batch(0, 300), rigs=(RIG, RIG + "\n[metric]\nhorizon = 2.0\n"))
    recording = read_recording(path)
    assert recording.rig is None
    assert "several different attachments of one name: rig.toml" in recording.warnings()[0]
    with pytest.raises(RecordingError, match="expected one rig file, found several that differ"):
        rig_of(recording, None)
    given = tmp_path / "given.toml"
    given.write_text(RIG, encoding="utf-8")
    assert rig_of(recording, given).text == RIG


def test_the_same_rig_file_twice_is_one(tmp_path):
    recording = read_recording(merged(tmp_path / "a.mcap", batch(0, 300), rigs=(RIG, RIG)))
    assert recording.rig is not None and not recording.warnings()
