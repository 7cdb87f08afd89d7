"""What is written is what is read, by us and by others, also where the writer did not get to its end."""

import json
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from labhil.codec import Codec
from labhil.errors import ProtocolError, RecordingError, RecordingFailedError
from labhil.recording import RecordingWriter, read_recording

sys.path.insert(0, str(Path(__file__).parent))
from samples_of_a_bench import RIG, START_NS, STATE, STEP_NS, batch

HERE = Path(__file__).parent


def record(path, count=1000, **metadata):
    with RecordingWriter(path) as writer:
        writer.attach("rig.toml", "application/toml", RIG.encode())
        writer.metadata("experiment", {"name": "two-sine"})
        channel = writer.add_stream("bench", STATE, metadata)
        for first in range(0, count, 100):
            writer.write(channel, batch(first, 100))
        writer.event("bench", START_NS + 50 * STEP_NS, {"text": "half way"})
    return path


def test_without_flushes_the_clock_has_no_say_in_the_bytes(tmp_path):
    for name, pause in (("quick.mcap", 0.0), ("slow.mcap", 0.3)):
        with RecordingWriter(tmp_path / name, flush_interval=math.inf) as writer:
            channel = writer.add_stream("bench", STATE)
            writer.write(channel, batch(0, 100))
            time.sleep(pause)
            writer.write(channel, batch(100, 100))
    assert (tmp_path / "quick.mcap").read_bytes() == (tmp_path / "slow.mcap").read_bytes()


def test_what_is_written_is_read(tmp_path):
    recording = read_recording(record(tmp_path / "a.mcap", serial="A1", speed="2"))
    data = recording.stream_with("ball_position", "joints")
    expected = batch(0, 1000)
    assert np.array_equal(data.values, expected.values)
    assert np.array_equal(data.seq, expected.seq)
    assert np.array_equal(data.t_acq_ns, expected.t_acq_ns)
    assert np.array_equal(data.t_hw_ns, expected.t_hw_ns)
    assert data["ball_position"].shape == (1000,)
    assert data["joints"].shape == (1000, 3)
    assert (data.device, data.stream, data.lost, data.speed) == ("bench", STATE, 0, 2.0)
    assert data.metadata == {"serial": "A1", "speed": "2", "device": "bench"}
    assert recording.complete
    assert recording.rig.kind.name == "ball_beam"
    assert recording.metadata["experiment"] == {"name": "two-sine"}
    assert recording.metadata["end"] == {"exit_status": "done", "reason": ""}
    (event,) = recording.events
    assert (event.device, event.topic, event.body) == ("bench", "event", {"text": "half way"})
    # whatever speed is declared: this is what the device's clock showed then
    assert event.t == pytest.approx(0.5)
    assert not list(tmp_path.glob("*.part"))


def test_the_official_reader_and_protobuf_read_the_same_numbers(tmp_path):
    path = record(tmp_path / "a.mcap", count=300)
    ours = read_recording(path).stream_with("ball_position")
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = list(reader.iter_messages(topics=["/bench/state"]))
        assert [attachment.name for attachment in reader.iter_attachments()] == ["rig.toml"]
    schema = found[0][0]
    pool = descriptor_pool.DescriptorPool()
    for file_descriptor in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file_descriptor)
    message_class = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    assert len(found) == len(ours) == 300
    for row, (_, channel, message) in enumerate(found):
        sample = message_class.FromString(message.data)
        assert [sample.servo_angle, sample.ball_position, *sample.joints] == ours.values[row].tolist()
        assert (sample.seq, sample.t_acq_ns, sample.t_hw_ns) == (row, ours.t_acq_ns[row], ours.t_hw_ns[row])
        assert message.log_time == message.publish_time == sample.t_acq_ns
        assert message.sequence == row
        assert json.loads(channel.metadata["labhil.stream"])["name"] == "state"


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_files_that_others_wrote_are_read(tmp_path, compression, use_chunking):
    """Other chunks, other compression, messages with a field left out."""
    ours = RecordingWriter(tmp_path / "pattern.mcap")
    ours.add_stream("bench", STATE)
    ours.finish()
    with (tmp_path / "pattern.mcap").open("rb") as file:
        channel = next(iter(make_reader(file).get_summary().channels.values()))
    codec = Codec(STATE)
    payloads = codec.encode(batch(0, 10))
    payloads[4] = payloads[4][: -3 * 8 - 2]  # the vector with its tag and its length
    with (tmp_path / "theirs.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=300, compression=compression, use_chunking=use_chunking)
        writer.start()
        schema = writer.register_schema(codec.schema_name, "protobuf", codec.descriptor_set())
        number = writer.register_channel(channel.topic, "protobuf", schema, channel.metadata)
        for payload in payloads:
            writer.add_message(number, START_NS, payload, START_NS)
        writer.finish()
    data = read_recording(tmp_path / "theirs.mcap").stream_with("joints")
    expected = batch(0, 10).values
    expected[4, 2:] = np.nan
    assert np.array_equal(data.values, expected, equal_nan=True)


def test_lost_samples_are_counted_and_not_filled(tmp_path):
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        channel = writer.add_stream("bench", STATE)
        writer.write(channel, batch(0, 500))
        writer.write(channel, Codec(STATE).encode(batch(507, 493)))
    data = read_recording(path).stream_with("ball_position")
    assert data.lost == 7
    assert len(data) == 993
    assert data.t[500] == pytest.approx(5.07)
    assert data.rate == pytest.approx(100.0)


def test_time_begins_at_the_first_sample_of_all_streams(tmp_path):
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        late, early = writer.add_stream("late", STATE), writer.add_stream("early", STATE)
        writer.write(late, batch(300, 200))
        writer.write(early, batch(0, 200))
    streams = {data.device: data for data in read_recording(path).streams}
    assert streams["early"].t[0] == 0.0
    assert streams["late"].t[0] == pytest.approx(3.0)


def test_a_killed_writer_loses_nothing_that_was_flushed(tmp_path):
    path = tmp_path / "a.mcap"
    script = HERE / "samples_of_a_bench.py"
    with subprocess.Popen([sys.executable, script, path], stdout=subprocess.PIPE) as process:
        flushed = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
    assert not path.exists()
    with pytest.raises(RecordingError, match=r"there is an unfinished recording .*a\.mcap\.part"):
        read_recording(path)
    recording = read_recording(tmp_path / "a.mcap.part")
    data = recording.stream_with("ball_position")
    assert not recording.complete
    assert "without the end" in recording.damage
    assert len(data) >= flushed
    assert np.array_equal(data.values, batch(0, len(data)).values)
    assert recording.rig is not None


def test_a_file_cut_anywhere_is_read_up_to_there_or_refused_in_words(tmp_path):
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        channel = writer.add_stream("bench", STATE)
        for first in range(0, 60, 20):
            writer.write(channel, batch(first, 20))
            writer.flush()
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    lengths = set()
    for size in range(1, len(whole), 97):
        cut.write_bytes(whole[:size])
        if size < 8:
            with pytest.raises(RecordingError, match="expected an MCAP recording"):
                read_recording(cut)
            continue
        recording = read_recording(cut)
        assert not recording.complete
        lengths |= {len(data) for data in recording.streams}
        for data in recording.streams:
            assert np.array_equal(data.values, batch(0, len(data)).values)
    assert lengths == {20, 40, 60}


def test_a_damaged_chunk_is_left_out_and_said(tmp_path):
    path = record(tmp_path / "a.mcap", count=5000)
    data = bytearray(path.read_bytes())
    data[len(data) // 10] ^= 0xFF
    path.write_bytes(data)
    recording = read_recording(path)
    assert not recording.complete
    assert "damaged record was left out" in recording.damage
    assert 0 < len(recording.stream_with("ball_position")) < 5000


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "found an empty file"),
        (b"t,x\n1,2\n", "labhil import"),
        (b"\x89MCA", "expected an MCAP recording"),
    ],
)
def test_what_is_no_recording_is_refused_in_words(tmp_path, content, found):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=found) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_and_a_folder_are_refused_in_words(tmp_path):
    with pytest.raises(RecordingError, match="there is no such file"):
        read_recording(tmp_path / "none.mcap")
    with pytest.raises(RecordingError, match="it is a folder; give the recordings in it"):
        read_recording(tmp_path)


def test_what_is_not_there_is_asked_for_in_vain_but_told_what_is(tmp_path):
    recording = read_recording(record(tmp_path / "a.mcap"))
    with pytest.raises(RecordingError, match=r"did you mean 'ball_position'.*/bench/state: servo_angle"):
        recording.stream_with("ball_positon")
    with pytest.raises(RecordingError, match="no signal 'joint'"):
        recording.stream_with("joints")["joint"]


def test_an_existing_recording_is_never_overwritten(tmp_path):
    path = record(tmp_path / "a.mcap")
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="expected a new file"):
        RecordingWriter(path)
    path.with_name("b.mcap.part").write_bytes(b"precious")
    with pytest.raises(RecordingError, match="unfinished recording"):
        RecordingWriter(tmp_path / "b.mcap")
    assert path.read_bytes() == before
    assert (tmp_path / "b.mcap.part").read_bytes() == b"precious"


def test_messages_of_another_stream_are_refused_and_the_file_stays_good(tmp_path):
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        channel = writer.add_stream("bench", STATE)
        writer.write(channel, batch(0, 10))
        negative = batch(0, 1)
        negative.t_acq_ns[0] = -1
        with pytest.raises(ProtocolError, match="negative"):
            writer.write(channel, negative)
        with pytest.raises(ProtocolError, match="found 5"):
            writer.write(channel, [b"other"])
        writer.write(channel, batch(10, 10))
    assert len(read_recording(path).stream_with("joints")) == 20


def fill_the_disk(path):
    """Runs in a process of its own, whose files may not grow beyond 200 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
    writer = RecordingWriter(path)
    channel = writer.add_stream("bench", STATE)
    errors = []
    for first in range(0, 100_000, 100):
        try:
            writer.write(channel, batch(first, 100))
            writer.flush()
        except RecordingFailedError as error:
            errors.append(str(error))
    os._exit(0 if errors and len(set(errors)) == 1 and "the disk failed" in errors[0] else 1)


def test_a_disk_that_fails_ends_the_recording_and_keeps_what_was_flushed(tmp_path):
    path = tmp_path / "a.mcap"
    code = (
        f"import sys; sys.path.insert(0, {str(HERE)!r});"
        "import test_recording as t; t.fill_the_disk(t.Path(sys.argv[1]))"
    )
    subprocess.run([sys.executable, "-c", code, path], check=True)
    data = read_recording(tmp_path / "a.mcap.part").stream_with("joints")
    assert len(data) >= 100
    assert np.array_equal(data.values, batch(0, len(data)).values)


def test_a_disk_nearly_full_ends_the_recording_with_its_name(tmp_path, monkeypatch):
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path)
    channel = writer.add_stream("bench", STATE)
    writer.write(channel, batch(0, 100))
    monkeypatch.setattr("labhil.recording.writer.MIN_FREE_SPACE", shutil.disk_usage(tmp_path).total)
    with pytest.raises(RecordingFailedError, match="left on the disk"):
        writer.flush()
    with pytest.raises(RecordingFailedError, match="left on the disk"):
        writer.write(channel, batch(100, 100))
    recording = read_recording(path)
    assert recording.complete
    assert len(recording.stream_with("joints")) == 100


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingFailedError, match="could not be created"):
        RecordingWriter(tmp_path / "file" / "a.mcap")


def test_an_error_inside_leaves_the_part_readable(tmp_path):
    with pytest.raises(ZeroDivisionError), RecordingWriter(tmp_path / "a.mcap") as writer:
        channel = writer.add_stream("bench", STATE)
        writer.write(channel, batch(0, 10))
        writer.flush()
        _ = 1 / 0
    assert len(read_recording(tmp_path / "a.mcap.part").stream_with("joints")) == 10


def test_reading_and_writing_load_nothing_heavy():
    code = (
        "import sys, labhil.recording, labhil.codec;"
        "heavy = {'zenoh', 'numba', 'scipy', 'matplotlib'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
