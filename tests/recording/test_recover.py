"""Broken recordings: every whole message is saved, none is invented, and what is lost is told."""

import signal
import struct
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from labhil.errors import RecordingError, RecordingFailedError
from labhil.recording import RecordingWriter, read_recording
from labhil.recording.recover import recover
from labhil.recording.salvage import checksum_matches, parse_chunk_header, salvage

sys.path.insert(0, str(Path(__file__).parent))
from samples_of_a_bench import RIG, STATE, batch

HERE = Path(__file__).parent
SHIPPED = HERE.parents[1] / "recordings"
CHUNK_HEAD = 9 + 32


def recorded(path, chunks=6):
    with RecordingWriter(path) as writer:
        writer.attach("rig.toml", "application/toml", RIG.encode())
        writer.metadata("experiment", {"name": "two-sine"})
        channel = writer.add_stream("bench", STATE)
        writer.flush()
        for number in range(chunks):
            writer.write(channel, batch(20 * number, 20))
            writer.event("bench", 1_700_000_000_000_000_000 + 20 * number * 10_000_000, {"text": str(number)})
            writer.flush()
    return path.read_bytes()


def foreign(compression, use_chunking=True, count=60):
    """A file of another writer, whose chunks hold about five messages each."""
    file = BytesIO()
    writer = Writer(file, chunk_size=300, compression=compression, use_chunking=use_chunking)
    writer.start(profile="theirs")
    number = writer.register_channel("/x", "raw", 0)
    for k in range(count):
        writer.add_message(number, 10**9 + k * 10**7, bytes([k + 1]) * 40, 5, k)
    writer.finish()
    return file.getvalue()


def truth(data):
    """All messages of a whole file, by mcap's own reader."""
    records = StreamReader(BytesIO(data)).records
    return [plain(record) for record in records if isinstance(record, Message)]


def plain(message):
    return (message.log_time, message.publish_time, message.sequence, message.data)


def chunks_of(data):
    """Where the chunks of a whole file begin and end, and how many messages each holds."""
    found, position = [], 8
    while position < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, position)
        end = position + 9 + length
        if opcode == Opcode.CHUNK:
            found.append([position, end, 0])
        if opcode == Opcode.MESSAGE_INDEX:
            found[-1][2] += (length - 6) // 16
        position = end
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("recover") / "a.mcap")


def saved(data, **options):
    return [plain(message) for message in salvage(data, **options).messages]


@settings(max_examples=25, deadline=None)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_of_a_file_cut_anywhere_all_before_the_cut_is_saved(whole, share):
    cut = int(share * len(whole))
    found, meant = saved(whole[:cut]), truth(whole)
    assert found == meant[: len(found)]
    assert len(found) >= sum(count for _, end, count in chunks_of(whole) if end <= cut)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_of_a_chunk_that_is_cut_off_the_messages_before_the_cut_are_saved(compression):
    data = foreign(compression)
    meant, ends = truth(data), chunks_of(data)
    start, end, count = ends[3]
    before = sum(number for _, _, number in ends[:3])
    found = saved(data[: end - 1])
    assert found == meant[: len(found)]
    if compression is CompressionType.NONE:
        assert len(found) == before + count - 1
    assert before <= len(found) <= before + count
    assert len(saved(data[: start + 20])) == before


def test_of_a_file_without_chunks_every_whole_message_is_saved():
    data = foreign(CompressionType.NONE, use_chunking=False)
    meant = truth(data)
    first = data.index(meant[0][3]) - 31
    for whole_messages, rest in ((0, 30), (7, 0), (7, 70), (59, 1)):
        assert len(saved(data[: first + 71 * whole_messages + rest])) == whole_messages
    broken = bytearray(data)
    broken[first + 71 * 9] = 0xFF  # the opcode of the tenth
    assert saved(bytes(broken)) == meant[:9] + meant[10:]


@settings(max_examples=25, deadline=None)
@given(
    hits=st.lists(
        st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=4
    )
)
def test_flipped_bytes_cost_the_chunks_they_hit_and_invent_nothing(whole, hits):
    broken = bytearray(whole)
    places = [8 + int(share * (len(whole) - 8)) for share, _ in hits]
    for place, (_, flip) in zip(places, hits, strict=True):
        broken[place] ^= flip
    found, meant = saved(bytes(broken)), truth(whole)
    untouched = [c for s, e, c in chunks_of(whole) if not any(s <= place < e for place in places)]
    assert len(found) >= sum(untouched)
    left = iter(meant)
    assert all(message in left for message in found), "in order, and each as it was written"


def test_a_wrong_checksum_alone_costs_nothing_and_wrong_content_is_left_out_or_marked(whole, tmp_path):
    start, _, count = chunks_of(whole)[2]
    crc = start + 9 + 24
    one_byte, all_bytes, content = (
        bytearray(whole),
        bytearray(whole),
        bytearray(foreign(CompressionType.NONE)),
    )
    one_byte[crc + 1] ^= 0x40
    assert saved(bytes(one_byte)) == truth(whole)
    all_bytes[crc : crc + 4] = b"\x12\x34\x56\x78"
    assert len(saved(bytes(all_bytes))) == len(truth(whole)) - count
    assert saved(bytes(all_bytes), keep_doubtful=True) == truth(whole)
    (tmp_path / "a.mcap").write_bytes(all_bytes)
    told = recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert any(f"checksum is wrong; its index names {count} messages" in line for line in told.lines())
    kept = recover(tmp_path / "a.mcap", tmp_path / "c.mcap", keep_doubtful=True)
    assert (kept.doubtful, kept.saved) == (count, len(truth(whole)))
    assert any("doubtful" in line for line in kept.lines())
    place = content.index(bytes([30]) * 40)
    content[place + 7] ^= 1
    assert bytes([30]) * 40 not in [message[3] for message in saved(bytes(content))]
    assert not checksum_matches(0x01020304, 0x01020000, whole_size=True)


@pytest.mark.parametrize("offset", [1, 3, 9, 17, 25, 37, 41, 44], ids=lambda offset: f"byte {offset}")
def test_a_damaged_head_of_a_chunk_costs_nothing_when_the_content_is_sound(whole, offset):
    broken = bytearray(whole)
    broken[chunks_of(whole)[2][0] + offset] ^= 0x15
    assert saved(bytes(broken)) == truth(whole)


def test_zeros_in_the_middle_and_at_the_end_are_stepped_over(whole):
    start, end, count = chunks_of(whole)[2]
    blank = whole[:start] + bytes(end - start) + whole[end:]
    assert len(saved(blank)) == len(truth(whole)) - count
    assert [loss.what for loss in salvage(blank).losses] == ["zeros"]
    assert saved(whole[:end] + bytes(4096)) == truth(whole)[: len(saved(whole[:end]))]


def test_what_is_recovered_is_a_good_recording_that_tells_what_was_lost(whole, tmp_path):
    start, end, _ = chunks_of(whole)[2]
    broken = bytearray(whole)
    broken[(start + end) // 2] ^= 0xFF
    (tmp_path / "broken.mcap").write_bytes(broken)
    result = recover(tmp_path / "broken.mcap", tmp_path / "saved.mcap")
    recording = read_recording(tmp_path / "saved.mcap")
    state = recording.stream_with("ball_position")
    assert recording.complete
    assert recording.rig.text == RIG
    assert recording.metadata["experiment"] == {"name": "two-sine"}
    assert recording.metadata["recover"]["bytes_lost"] == str(end - start)
    assert "missing between" in recording.metadata["recover"]["lost"]
    hole = (set(range(6)) - set((state.seq // 20).tolist())).pop()
    assert state.seq.tolist() == [seq for seq in range(120) if seq // 20 != hole]
    assert (state.lost, len(recording.events)) == (20, 5)
    (stream, events) = result.streams
    assert (stream.saved, stream.expected, stream.spans[0].missing) == (100, 120, 20)
    assert (events.saved, events.expected) == (5, 6)
    assert result.bytes_lost == end - start
    assert result.to_json()["chunks_lost"] == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["broken.mcap", "saved.mcap"]


def test_a_part_of_a_killed_recorder_becomes_a_recording(tmp_path):
    command = [sys.executable, HERE / "samples_of_a_bench.py", tmp_path / "a.mcap"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        flushed = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
    before = (tmp_path / "a.mcap.part").read_bytes()
    result = recover(tmp_path / "a.mcap.part", tmp_path / "a.mcap")
    recording = read_recording(tmp_path / "a.mcap")
    state = recording.stream_with("ball_position")
    assert recording.complete
    assert recording.rig is not None
    assert len(state) >= flushed
    assert np.array_equal(state.values, batch(0, len(state)).values)
    assert any("no end (footer)" in line for line in result.lines())
    assert (tmp_path / "a.mcap.part").read_bytes() == before


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_files_of_others_are_recovered(tmp_path, compression, use_chunking):
    data = foreign(compression, use_chunking)
    (tmp_path / "a.mcap").write_bytes(data[:-60])
    recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert truth((tmp_path / "b.mcap").read_bytes()) == truth(data)


def test_messages_that_nothing_describes_are_counted_as_lost(tmp_path):
    data = recorded(tmp_path / "whole.mcap")
    first = chunks_of(data)[0]
    end = chunks_of(data)[-1][1]
    (tmp_path / "a.mcap").write_bytes(data[: first[0]] + data[first[1] : end])  # no description, no summary
    with pytest.raises(RecordingError, match="found no complete one"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    (tmp_path / "c.mcap").write_bytes(data[: first[0]] + data[first[1] :])  # the summary describes them
    assert recover(tmp_path / "c.mcap", tmp_path / "d.mcap").saved >= 100


def test_a_damaged_beginning_is_no_end(whole, tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"\x00" * 8 + whole[8:])
    assert recover(tmp_path / "a.mcap", tmp_path / "b.mcap").saved == len(truth(whole))


NOT_ONES = {
    "empty": (b"", "found an empty file"),
    "text": (b"t,x\n" * 500, "expected an MCAP recording, found a file that begins with"),
    "zeros": (bytes(3000), "expected an MCAP recording"),
    "magic alone": (b"\x89MCAP0\r\n", "found no complete one in 8 bytes"),
    "magic and garbage": (b"\x89MCAP0\r\n" + bytes(range(256)) * 8, "found no complete one"),
}


@pytest.mark.parametrize("case", NOT_ONES)
def test_what_is_no_recording_is_refused_and_nothing_is_written(tmp_path, case):
    content, message = NOT_ONES[case]
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=message):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_nothing_is_overwritten_and_an_unwritable_place_is_named(whole, tmp_path):
    (tmp_path / "a.mcap").write_bytes(whole)
    (tmp_path / "b.mcap").write_bytes(b"precious")
    with pytest.raises(RecordingError, match="found one that exists; nothing was written"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match="found one that exists"):
        recover(tmp_path / "a.mcap", tmp_path / "a.mcap")
    (tmp_path / "c.mcap.saving").write_bytes(b"precious")
    with pytest.raises(RecordingError, match="move it away first"):
        recover(tmp_path / "a.mcap", tmp_path / "c.mcap")
    with pytest.raises(RecordingFailedError, match="could not be written"):
        recover(tmp_path / "a.mcap", tmp_path / "none" / "d.mcap")
    with pytest.raises(RecordingError, match="there is no such file"):
        recover(tmp_path / "none.mcap", tmp_path / "d.mcap")
    with pytest.raises(RecordingError, match="it is a folder; give the recordings in it"):
        recover(tmp_path, tmp_path / "d.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == whole
    assert {(tmp_path / name).read_bytes() for name in ("b.mcap", "c.mcap.saving")} == {b"precious"}


def test_a_full_disk_is_told_and_leaves_nothing(whole, tmp_path):
    (tmp_path / "a.mcap").write_bytes(whole)
    code = (
        "import resource, sys; from pathlib import Path; from labhil.recording.recover import recover\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))\n"
        "recover(Path('a.mcap'), Path('b.mcap'))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert "RecordingFailedError: b.mcap: could not be written" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.extended
@pytest.mark.timeout(600)
def test_a_shipped_recording_cut_at_many_places_and_struck_at_many_others(tmp_path):
    data = (SHIPPED / "ball_beam_identify.mcap").read_bytes()
    meant, chunks = truth(data), chunks_of(data)
    random = np.random.default_rng(8)
    for cut in random.integers(8, len(data), 150).tolist():
        found = saved(data[:cut])
        assert found == meant[: len(found)]
        assert len(found) >= sum(count for _, end, count in chunks if end <= cut)
    for _ in range(150):
        places = random.integers(8, len(data), int(random.integers(1, 12))).tolist()
        broken = bytearray(data)
        for place in places:
            broken[place] ^= int(random.integers(1, 256))
        found = saved(bytes(broken))
        kept = sum(c for s, e, c in chunks if not any(s <= place < e for place in places))
        assert len(found) >= kept
        left = iter(meant)
        assert all(message in left for message in found)
    (tmp_path / "a.mcap").write_bytes(broken)
    recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert truth((tmp_path / "b.mcap").read_bytes()) == found


def test_the_head_of_a_chunk_that_contradicts_itself_is_none(whole):
    start = chunks_of(whole)[0][0]
    assert parse_chunk_header(whole, start).end == chunks_of(whole)[0][1]
    assert parse_chunk_header(whole, start + 1) is None
    assert parse_chunk_header(whole[: start + CHUNK_HEAD], start) is None


def test_an_index_that_one_wrong_bit_has_made_a_message_is_none(whole):
    meant = set(truth(whole))
    indexes = [end for _, end, _ in chunks_of(whole)]
    struck = [at for at in indexes if whole[at] == Opcode.MESSAGE_INDEX]
    assert struck
    for at in struck:
        broken = bytearray(whole)
        broken[at] = Opcode.MESSAGE
        assert set(saved(bytes(broken))) == meant
