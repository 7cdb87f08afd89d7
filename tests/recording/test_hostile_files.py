"""Files that are damaged, or made to do harm: each is read, or refused with an error of ours, and soon."""

import json
import random
import sys
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from scipy.io import savemat

from labhil.analysis.saved_model import accepted_of
from labhil.documents import DocumentError, parse_json, parse_toml
from labhil.errors import LabhilError, ModelFileError
from labhil.recording import RecordingWriter, read_recording
from labhil.recording.recover import recover
from labhil.recording.tables import import_table
from labhil.rig import load_rig, parse_rig

sys.path.insert(0, str(Path(__file__).parent))
from samples_of_a_bench import RIG, STATE, batch

SEED = 20_260_101
TABLE_RIG = parse_rig(
    '[rig]\nkind = "ball_beam"\n[channels]\nt = { column = "t" }\nball_position = { column = "x" }\n'
    'servo_angle = { column = "u", scale = 0.5 }\n',
    Path("rig.toml"),
)
T = np.linspace(0.0, 1.9, 20)
ROWS = [[t, np.sin(t), k] for k, t in enumerate(T.tolist())]


def spoilt(data, draw):
    """The bytes with one to three things done to them: bits flipped, bytes set, cut, doubled, or left out."""
    broken = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        place = draw.randrange(len(broken))
        what = draw.randrange(6)
        if what <= 2:
            broken[place] ^= 1 << draw.randrange(8)
        elif what == 3:
            length = draw.choice((1, 2, 4, 8))
            broken[place : place + length] = draw.choice((b"\x00", b"\xff", b"\x7f", b"\x80")) * length
        elif what == 4:
            end = place + draw.randrange(1, 200)
            broken[place:place] = broken[place:end]
        else:
            del broken[place : draw.choice((place + draw.randrange(1, 200), len(broken)))]
        if not broken:
            return b"\x00"
    return bytes(broken)


def recorded(path):
    with RecordingWriter(path) as writer:
        writer.attach("rig.toml", "application/toml", RIG.encode())
        writer.metadata("experiment", {"name": "two-sine"})
        channel = writer.add_stream("bench", STATE)
        for number in range(3):
            writer.write(channel, batch(20 * number, 20))
            writer.event("bench", 1_700_000_000_000_000_000 + number, {"text": str(number)})
            writer.flush()
    return path.read_bytes()


def plainly_packed(data, compression):
    """The same messages by mcap's own writer, with another compression, or without chunks."""
    file = BytesIO()
    writer = Writer(file, chunk_size=2000, compression=compression, use_chunking=compression is not None)
    writer.start(profile="")
    numbers, schemas = {}, {}
    for record in StreamReader(BytesIO(data)).records:
        kind = type(record).__name__
        if kind == "Schema" and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif kind == "Channel" and record.id not in numbers:
            schema = schemas[record.schema_id]
            numbers[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schema, record.metadata
            )
        elif kind == "Message":
            number = numbers[record.channel_id]
            writer.add_message(number, record.log_time, record.data, record.publish_time, record.sequence)
    writer.finish()
    return file.getvalue()


def messages(data):
    records = StreamReader(BytesIO(data)).records
    return [(m.log_time, m.sequence, m.data) for m in records if isinstance(m, Message)]


def only_our_errors(call, *arguments, **options):
    """What a call returns; None when it raises an error of ours, whose text a terminal may show."""
    try:
        return call(*arguments, **options)
    except LabhilError as error:
        assert str(error).strip()
        return None


def read_in_every_way(data, folder, original, checksums):
    """Read and recover a file; where checksums guard the messages, none is found that was not there."""
    path, saved, doubtful = folder / "broken.mcap", folder / "saved.mcap", folder / "doubtful.mcap"
    path.write_bytes(data)
    recording = only_our_errors(read_recording, path)
    if recording is not None:
        recording.warnings()
        _ = recording.duration, recording.clocks, recording.clock_offsets
    before = [path.name]
    if only_our_errors(recover, path, saved) is not None:
        if checksums:
            assert set(messages(saved.read_bytes())) <= original
        only_our_errors(read_recording, saved)
        before.append(saved.name)
    if only_our_errors(recover, path, doubtful, keep_doubtful=True) is not None:
        only_our_errors(read_recording, doubtful)
        before.append(doubtful.name)
    assert sorted(inner.name for inner in folder.iterdir()) == sorted(before), "nothing else is left"
    for inner in folder.iterdir():
        inner.unlink()


def spoil_recordings(tmp_path, cases):
    data = recorded(tmp_path / "whole.mcap")
    variants = [data, *(plainly_packed(data, packed) for packed in (*CompressionType, None))]
    folder, draw = tmp_path / "cases", random.Random(SEED)
    folder.mkdir()
    for number in range(cases):
        whole = variants[number % len(variants)]
        # nothing guards messages outside of chunks, nor those of a chunk that is not packed and was cut off
        checksums = number % len(variants) not in (1, len(variants) - 1)
        broken = spoilt(whole, draw)
        try:
            read_in_every_way(broken, folder, set(messages(whole)), checksums)
        except BaseException:
            (tmp_path / "failed.mcap").write_bytes(broken)
            raise


@pytest.mark.extended
def test_a_spoilt_recording_is_read_or_refused(tmp_path):
    spoil_recordings(tmp_path, 100)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_many_spoilt_recordings_are_read_or_refused(tmp_path):
    spoil_recordings(tmp_path, 4000)


def as_csv(path):
    path.write_text("t,x,u\n" + "".join(f"{t},{x},{u}\n" for t, x, u in ROWS))


def as_workbook(path):
    book = openpyxl.Workbook()
    for row in (["t", "x", "u"], *ROWS):
        book.active.append(row)
    book.save(path)


def as_parquet(path):
    pq.write_table(pa.table(dict(zip("txu", map(list, zip(*ROWS, strict=True)), strict=True))), path)


def as_mat(path):
    savemat(path, {name: np.array(ROWS)[:, [k]] for k, name in enumerate("txu")}, do_compression=False)


def as_packed_mat(path):
    inside = {"t": np.array(ROWS)[:, [0]], "s": {"x": np.array(ROWS)[:, [1]]}, "names": ["a", "b"]}
    savemat(path, {**inside, "u": np.array(ROWS)[:, [2]], "x": np.array(ROWS)[:, [1]]}, do_compression=True)


def as_old_mat(path):
    savemat(path, {name: np.array(ROWS)[:, [k]] for k, name in enumerate("txu")}, format="4")


def as_hdf5(path):
    with h5py.File(path, "w") as file:
        for k, name in enumerate("txu"):
            file.create_dataset(name, data=np.array(ROWS)[:, k], compression="gzip", chunks=(10,))


TABLES = {
    "a.csv": as_csv,
    "a.xlsx": as_workbook,
    "a.parquet": as_parquet,
    "a.mat": as_mat,
    "packed.mat": as_packed_mat,
    "old.mat": as_old_mat,
    "a.h5": as_hdf5,
}


def spoil_tables(tmp_path, name, cases):
    path, draw = tmp_path / name, random.Random(SEED)
    TABLES[name](path)
    whole = path.read_bytes()
    assert len(import_table(path, TABLE_RIG)) == len(ROWS)
    for _ in range(cases):
        path.write_bytes(spoilt(whole, draw))
        try:
            only_our_errors(import_table, path, TABLE_RIG)
        except BaseException:
            path.rename(tmp_path / f"failed{path.suffix}")
            raise


@pytest.mark.parametrize("name", TABLES)
def test_a_spoilt_table_is_read_or_refused(tmp_path, name):
    spoil_tables(tmp_path, name, 30)


@pytest.mark.extended
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", TABLES)
def test_many_spoilt_tables_are_read_or_refused(tmp_path, name):
    spoil_tables(tmp_path, name, 700)


RIG_TEXT = """[rig]
kind = "ball_beam"
[known]
ball_mass = 0.261
ball_radius = 0.02
[nominal]
viscous_friction.coefficient = 0.1
[limits]
servo_angle = { min = -1.2, max = 1.2, rate = 6.0 }
[table]
bad_rows = "drop"
[channels]
t = { column = "time_ms", scale = 1e-3 }
ball_position = { column = 1, scale = 1e-3, offset = 0.0 }
"""


def spoil_rigs(tmp_path, cases):
    path, draw = tmp_path / "rig.toml", random.Random(SEED)
    for _ in range(cases):
        path.write_bytes(spoilt(RIG_TEXT.encode(), draw))
        only_our_errors(load_rig, path)


def test_a_spoilt_rig_file_is_read_or_refused(tmp_path):
    spoil_rigs(tmp_path, 100)


@pytest.mark.extended
def test_many_spoilt_rig_files_are_read_or_refused(tmp_path):
    spoil_rigs(tmp_path, 2000)


@pytest.mark.parametrize("depth", [70, 900, 100_000])
@pytest.mark.parametrize("pair", ["[]", "{}"])
def test_documents_that_are_nested_too_deeply_are_refused(depth, pair):
    inner = '"a":' if pair == "{}" else ""
    text = (pair[0] + inner) * depth + "1" + pair[1] * depth
    with pytest.raises(DocumentError, match="at most 64 levels"):
        parse_json(text)
    toml = "a = " + ((pair[0] + inner.replace(":", "=")) * depth + "1" + pair[1] * depth)
    with pytest.raises(DocumentError, match="at most 64 levels"):
        parse_toml(toml)


def test_documents_with_a_number_of_too_many_digits_are_refused():
    for parse, text in ((parse_json, "[" + "9" * 5000 + "]"), (parse_toml, "a = " + "9" * 5000)):
        with pytest.raises(DocumentError):
            parse(text)
    assert parse_json('{"a": [[1], {"b": null}]}') == {"a": [[1], {"b": None}]}
    assert parse_json("[NaN]", constant=lambda name: None) == [None]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"window": 10**400}, "window"),
        ({"parameters": [{"name": "a", "value": 10**400}]}, "parameters"),
        ({"covariance": [[10**400]]}, "covariance"),
        ({"train": {"per_channel": 7}}, "train.per_channel"),
    ],
)
def test_a_model_file_with_a_value_that_no_model_can_have_is_refused(tmp_path, change, field):
    whole = {"schema": "labhil.fit/1", "terms": [], "parameters": [{"name": "a", "value": 1.0}]}
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(whole))
    assert accepted_of(path).values == {"a": 1.0}
    path.write_text(json.dumps({**whole, **change}))
    with pytest.raises(ModelFileError, match=f"fit.json: {field}: expected"):
        accepted_of(path)
