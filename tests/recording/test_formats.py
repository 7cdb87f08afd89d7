"""The formats of others: what is written is read back, and every rule for tables holds in each of them."""

import sqlite3
import subprocess
import sys
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

from labhil.errors import MissingExtraError, RecordingError, TableError, UsageError
from labhil.recording import describe_import, export, import_table, read_recording, write_import
from labhil.recording.writer import RecordingWriter
from labhil.rig import parse_rig
from labhil.signals import Batch, Direction, Signal, Stream

HEAD = '[rig]\nkind = "ball_beam"\n'
NAMES = ("t", "ball_position", "servo_angle", "note")
T = np.arange(20) / 10
GOOD = [[t, k, -k, "x"] for k, t in enumerate(T.tolist())]


def rig(text="", kind="ball_beam"):
    return parse_rig(f'[rig]\nkind = "{kind}"\n{text}', Path("rig.toml"))


def as_workbook(path, rows, names=NAMES, sheet="Sheet"):
    book = openpyxl.Workbook()
    book.active.title = sheet
    for row in [names, *rows] if names else rows:
        book.active.append(row)
    book.save(path)
    return path


def as_parquet(path, rows, names=NAMES):
    columns = {name: [row[place] for row in rows] for place, name in enumerate(names)}
    pq.write_table(pa.table(columns), path)
    return path


def as_mat(path, rows, names=NAMES):
    numbers = [[np.nan if cell is None else cell for cell in row[:3]] for row in rows]
    savemat(path, {name: np.array(numbers)[:, [place]] for place, name in enumerate(names[:3])})
    return path


def as_hdf5(path, rows, names=NAMES):
    """As MATLAB writes version 7.3: 512 bytes of text before it, columns as rows, the class as attribute."""
    numbers = np.array([[np.nan if cell is None else cell for cell in row[:3]] for row in rows], dtype=float)
    with h5py.File(path, "w", userblock_size=512) as file:
        for place, name in enumerate(names[:3]):
            variable = file.create_dataset(name, data=numbers[:, [place]].T)
            variable.attrs["MATLAB_class"] = np.bytes_("double")
        who = file.create_dataset("who", data=np.array([[109], [101]], dtype=np.uint16))
        who.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    return path


BENCH = "std_msgs/Header header\nfloat64 position\nfloat64[] raw\nstring note\n"


def as_bag(path, rows, names=NAMES, plugin=StoragePlugin.MCAP):
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(BENCH, "bench_msgs/msg/Bench"))
    bench, header, time = (
        store.types[kind]
        for kind in ("bench_msgs/msg/Bench", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/bench/state", bench.__msgtype__, typestore=store)
        for number, (t, x, u, _) in enumerate(rows):
            stamp_ns = round((1.6e9 + t) * 1e9)
            told = header(stamp=time(*divmod(stamp_ns, 10**9)), frame_id="")
            message = bench(told, np.nan if x is None else float(x), np.array([u, 2.0 * u]), "x")
            raw = store.serialize_cdr(message, bench.__msgtype__)
            writer.write(connection, 1_700_000_000_000_000_000 + number * 10**8, raw)
    return path


BAG = """
[channels]
ball_position = { column = "/bench/state.position" }
servo_angle = { column = "bench/state.raw[0]" }
"""
FORMATS = {
    "workbook": (as_workbook, "data.xlsx", ""),
    "parquet": (as_parquet, "data.parquet", ""),
    "mat": (as_mat, "data.mat", ""),
    "hdf5": (as_hdf5, "data.mat", ""),
    "bag": (as_bag, "bag", BAG),
}


@pytest.mark.parametrize("name", FORMATS)
def test_a_table_is_the_same_in_every_format(tmp_path, name):
    write, file, toml = FORMATS[name]
    table = import_table(write(tmp_path / file, GOOD), rig(toml))
    assert table.t == pytest.approx(T, abs=1e-6)
    assert table.values.tolist() == [[-k, k] for k in range(20)]
    assert not any(table.dropped.values())
    assert table.rows == 20


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize(
    ("row", "reason"),
    [([0.95, None, 2, "x"], "not_finite"), ([0.2, 1, 2, "x"], "time"), ([1e6, 1, 2, "x"], "time")],
)
def test_a_bad_row_is_dropped_and_counted_or_refused_in_every_format(tmp_path, name, row, reason):
    write, file, toml = FORMATS[name]
    path = write(tmp_path / file, [*GOOD[:10], row, *GOOD[10:]])
    table = import_table(path, rig(toml))
    assert {key: count for key, count in table.dropped.items() if count} == {reason: 1}
    assert table.row.tolist() == [k for k in range(21) if k != 10]
    assert any("dropped: 1 rows" in line for line in describe_import(table))
    with pytest.raises(TableError, match=r"(row|line|message) 1[123]: "):
        import_table(path, rig(f'[table]\nbad_rows = "fail"\n{toml}'))


@pytest.mark.parametrize("name", FORMATS)
def test_a_cut_file_is_refused_in_words(tmp_path, name):
    write, file, toml = FORMATS[name]
    path = write(tmp_path / file, GOOD)
    inner = next(path.glob("*.mcap")) if path.is_dir() else path
    inner.write_bytes(inner.read_bytes()[:-40])
    with pytest.raises(TableError, match=r"expected .* found one that"):
        import_table(path, rig(toml))


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "bag"])
def test_a_missing_column_is_named_in_every_format(tmp_path, name):
    write, file, _ = FORMATS[name]
    path = write(tmp_path / file, GOOD, ("t", "ball_positon", "servo_angle", "note"))
    with pytest.raises(TableError, match=r"did you mean 'ball_positon'.*found the columns .*servo_angle"):
        import_table(path, rig())


def test_a_workbook_has_sheets_skipped_rows_comments_and_texts_that_are_numbers(tmp_path):
    rows = [
        ["Instrument 7"],
        [],
        ["t", "ball_position", "servo_angle"],
        ["# V", 1, 2],
        [0, "1,5", 2],
        [1, 2.5, 3],
    ]
    path = as_workbook(tmp_path / "data.xlsx", rows, None, "run 1")
    toml = '[table]\nskip_rows = 1\ncomment = "#"\ndecimal = ","\nsheet = "run 1"'
    assert import_table(path, rig(toml)).values.tolist() == [[2.0, 1.5], [3.0, 2.5]]
    with pytest.raises(TableError, match=r"expected a sheet 'run 2' \(did you mean 'run 1'\?\), found run 1"):
        import_table(path, rig('[table]\nsheet = "run 2"'))


def test_a_workbook_without_a_header_goes_by_numbers_and_a_row_too_long_is_bad(tmp_path):
    path = as_workbook(tmp_path / "data.xlsx", [[1, 2], [3, 4], [5, 6, 7], [None, 8], [9, 10]], None)
    toml = (
        '[table]\nrate = 10\nbad_rows = "drop"\n'
        "[channels]\nbeam_angle = { column = 0 }\nball_position = { column = 1 }"
    )
    table = import_table(path, rig(toml))
    assert table.values.tolist() == [[1.0, 2.0], [3.0, 4.0], [9.0, 10.0]]
    assert (table.dropped["field_count"], table.dropped["not_finite"]) == (1, 1)


def test_dates_are_seconds(tmp_path):
    start = datetime(2026, 3, 29, 1, 59, 59)
    rows = [[start + timedelta(seconds=k / 4), k, -k, "x"] for k in range(8)]
    for path in (as_workbook(tmp_path / "a.xlsx", rows), as_parquet(tmp_path / "a.parquet", rows)):
        table = import_table(path, rig())
        assert table.t == pytest.approx(np.arange(8) / 4, abs=1e-3)
        assert table.time_origin == pytest.approx(1774749599.0)


def test_lists_in_parquet_are_vectors_and_nulls_are_bad(tmp_path):
    path = tmp_path / "a.parquet"
    values = [[float(k + joint) for joint in range(6)] for k in range(10)]
    broken = [*values[:4], None, *values[5:]]
    columns = {
        "timestamp": T[:10],
        "actual_q": values,
        "actual_qd": pa.array(values, pa.list_(pa.float32(), 6)),
    }
    pq.write_table(pa.table({**columns, "actual_current": broken}), path)
    table = import_table(path, rig(kind="ur5"))
    assert table.stream.names() == ("actual_q", "actual_qd", "actual_current")
    assert table.dropped["not_finite"] == 1
    assert table.values[4, :6].tolist() == values[5]


def test_structs_in_mat_files_have_fields(tmp_path):
    fields = {"t": T[:, None], "ball_position": T[:, None] ** 2, "servo_angle": T[:, None]}
    savemat(tmp_path / "a.mat", {"log": fields, "who": "me"})
    toml = (
        '[channels]\nt={column="log.t"}\nball_position={column="log.ball_position"}\nservo_angle={column=2}'
    )
    assert import_table(tmp_path / "a.mat", rig(toml)).values[:, 1] == pytest.approx(T**2)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        for name, value in fields.items():
            file[f"log/{name}"] = value[:, 0]
    table = import_table(tmp_path / "b.h5", rig(toml.replace("column=2", 'column="log.servo_angle"')))
    assert table.values[:, 1] == pytest.approx(T**2)


def test_a_mat_file_of_version_4_is_read(tmp_path):
    savemat(tmp_path / "a.mat", {"t": T, "ball_position": T, "servo_angle": T}, format="4")
    assert len(import_table(tmp_path / "a.mat", rig())) == 20


def two_topics(path):
    """Positions at 10 Hz, and commands at 2 Hz on another topic, between 0.5 and 1.5 s."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/Float64"
    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = [writer.add_connection(topic, kind, typestore=store) for topic in ("/position", "/command")]
        for topic, times in ((topics[0], T), (topics[1], [0.5, 1.0, 1.5])):
            for t in times:
                raw = store.serialize_cdr(store.types[kind](float(t)), kind)
                writer.write(topic, 10**18 + round(t * 1e9), raw)
    return path


@pytest.mark.parametrize(
    ("kind", "names", "expected"),
    [
        ("dc_motor", ("speed", "voltage"), [0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.5]),
        ("ball_beam", ("ball_position", "servo_angle"), T[5:16]),
    ],
)
def test_another_topic_is_held_or_goes_along_a_line(tmp_path, kind, names, expected):
    toml = '[table]\nbad_rows = "drop"\n[channels]\n' + "\n".join(
        f'{name} = {{ column = "{topic}.data" }}'
        for name, topic in zip(names, ("/position", "/command"), strict=True)
    )
    table = import_table(two_topics(tmp_path / "bag"), rig(toml, kind))
    assert (table.rows, len(table), table.dropped["not_finite"]) == (20, 11, 9)
    assert table.values[:, 0] == pytest.approx(np.array(expected), abs=1e-6)
    assert any("command is another topic" in line for line in describe_import(table))
    recording = read_recording(write_import(table, tmp_path / "rec.mcap"))
    assert "command is another topic" in recording.metadata["import"]["note.1"]


def test_a_bag_is_a_folder_or_its_file_and_both_clocks_are_there(tmp_path):
    path = as_bag(tmp_path / "bag", [*GOOD[:5], [0.5005, 5, -5, "x"], *GOOD[6:]])
    by_stamp = import_table(path, rig(BAG))
    by_file = import_table(next(path.glob("*.mcap")), rig(BAG))
    assert by_stamp.t.tolist() == by_file.t.tolist()
    assert by_stamp.t[5] == pytest.approx(0.5005, abs=1e-6)
    assert by_stamp.time_origin == pytest.approx(1.6e9)
    received = import_table(path, rig(BAG + 't = { column = "received" }\n'))
    assert received.t[5] == pytest.approx(0.5, abs=1e-6)
    assert received.time_origin == pytest.approx(1.7e9)
    with pytest.raises(TableError, match=r"'/bench/state.pos'.*did you mean '/bench/state.position'"):
        import_table(path, rig(BAG.replace('position"', 'pos"')))


def test_folders_and_mcap_files_that_are_no_bags_are_refused(tmp_path):
    (tmp_path / "some.txt").write_text("")
    with pytest.raises(TableError, match=r"found a folder with some\.txt"):
        import_table(tmp_path, rig())
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.add_stream("bench", Stream("state", (Signal("x", "m", Direction.OUTPUT),), 1.0))
    with pytest.raises(TableError, match="which needs no import"):
        import_table(tmp_path / "a.mcap", rig())
    with sqlite3.connect(tmp_path / "a.db3") as base:
        base.execute("create table x (y)")
    base.close()
    with pytest.raises(TableError, match="expected a ROS 2 bag, found one that cannot be read"):
        import_table(tmp_path / "a.db3", rig(BAG))


UR = [f"{name}_{joint}" for name in ("actual_q", "actual_qd", "actual_current") for joint in range(6)]


@pytest.mark.parametrize("delimiter", [",", " "])
@pytest.mark.parametrize("end", ["", "SEP"])
def test_logs_of_rtde_recorders_need_no_mapping(tmp_path, delimiter, end):
    """Space or comma between the fields, and perhaps one more at the end of each line."""
    end = end.replace("SEP", delimiter)
    names = ["timestamp", "robot_mode", *UR]
    lines = [delimiter.join(names) + end]
    lines += [
        delimiter.join([f"{100 + k / 500:.3f}", "7", *[str(k + c) for c in range(18)]]) + end
        for k in range(9)
    ]
    (tmp_path / "robot_data.csv").write_text("\n".join(lines) + "\n")
    table = import_table(tmp_path / "robot_data.csv", rig(kind="ur5"))
    assert table.stream.rate == pytest.approx(500.0)
    assert table.values[3].tolist() == [3.0 + c for c in range(18)]


STREAM = Stream(
    "state",
    (
        Signal("servo_angle", "rad", Direction.INPUT),
        Signal("ball_position", "m", Direction.OUTPUT),
        Signal("joints", "rad", Direction.STATUS, width=3),
    ),
    100.0,
)


def record(path, values, devices=("bench",)):
    seq = np.arange(len(values), dtype=np.int64)
    with RecordingWriter(path) as writer:
        for device in devices:
            channel = writer.add_stream(device, STREAM)
            writer.write(channel, Batch(seq, 10**18 + seq * 10**7, seq * 10**7, np.asarray(values, float)))
    return read_recording(path)


MAPPED = {
    ".csv": "",
    ".parquet": "",
    ".mat": "",
    ".xlsx": "",
    ".rosbag2": '[channels]\nt={column="/bench/state.t"}\n'
    'ball_position={column="/bench/state.ball_position"}\nservo_angle={column="/bench/state.servo_angle"}',
}
FINITE = st.floats(-1e300, 1e300)  # a workbook holds no larger ones


@pytest.mark.parametrize("suffix", MAPPED)
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=st.lists(st.lists(FINITE, min_size=5, max_size=5), min_size=4, max_size=12))
def test_what_is_exported_is_imported_as_it_was(tmp_path_factory, suffix, rows):
    folder = tmp_path_factory.mktemp("export")
    recording = record(folder / "a.mcap", rows)
    out = export(recording, folder / f"out{suffix}")
    table = import_table(out, rig(MAPPED[suffix]))
    digits = 1e-15 if suffix == ".xlsx" else 0.0  # a workbook's numbers have 16
    assert table.values == pytest.approx(np.array(rows)[:, :2], rel=digits, abs=0.0)
    assert table.t == pytest.approx(recording.streams[0].t, rel=digits, abs=0.0)
    assert sorted(path.name for path in folder.iterdir()) == ["a.mcap", out.name]


def test_units_stand_in_the_parquet_file_and_vectors_in_the_mat_file(tmp_path):
    recording = record(tmp_path / "a.mcap", np.ones((4, 5)))
    schema = pq.read_schema(export(recording, tmp_path / "a.parquet"))
    assert schema.field("joints_2").metadata == {b"unit": b"rad"}
    from scipy.io import loadmat

    assert loadmat(export(recording, tmp_path / "a.mat"))["joints"].shape == (4, 3)


def test_nothing_stands_where_a_sample_was_not_finite(tmp_path):
    values = np.ones((4, 5))
    values[1, 0], values[2, 1] = np.nan, np.inf
    recording = record(tmp_path / "a.mcap", values)
    for suffix in (".xlsx", ".parquet", ".csv", ".mat"):
        table = import_table(export(recording, tmp_path / f"a{suffix}"), rig('[table]\nbad_rows = "drop"'))
        assert (len(table), table.dropped["not_finite"]) == (2, 2), suffix


def test_one_of_several_streams_is_chosen_by_name(tmp_path):
    recording = record(tmp_path / "a.mcap", np.ones((4, 5)), ("bench", "other"))
    with pytest.raises(
        RecordingError, match=r"found /bench/state, /other/state; choose with --stream or --device"
    ):
        export(recording, tmp_path / "a.csv")
    assert export(recording, tmp_path / "a.csv", "other/state").is_file()
    with pytest.raises(RecordingError, match=r"expected a stream /othr/state \(did you mean '/other/state'"):
        export(recording, tmp_path / "a.csv", "/othr/state")
    export(recording, tmp_path / "a.rosbag2")
    with pytest.raises(UsageError, match="expected a new folder"):
        export(recording, tmp_path / "a.rosbag2")


def test_an_unwritable_place_is_named_and_nothing_is_left(tmp_path):
    recording = record(tmp_path / "a.mcap", np.ones((4, 5)))
    (tmp_path / "file").write_text("")
    for suffix in MAPPED:
        with pytest.raises(UsageError, match="cannot be written"):
            export(recording, tmp_path / "file" / f"out{suffix}")
        with pytest.raises(UsageError, match="cannot be written"):
            export(recording, tmp_path / "none" / f"out{suffix}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "file"]


@pytest.mark.parametrize(
    ("module", "file"),
    [("openpyxl", "a.xlsx"), ("pyarrow", "a.parquet"), ("h5py", "b.mat"), ("rosbags", "bag")],
)
def test_without_its_package_the_extra_is_named(tmp_path, monkeypatch, module, file):
    as_workbook(tmp_path / "a.xlsx", GOOD)
    as_parquet(tmp_path / "a.parquet", GOOD)
    as_hdf5(tmp_path / "b.mat", GOOD)
    as_bag(tmp_path / "bag", GOOD)
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"{module}.*pip install 'labhil\[formats\]'"):
        import_table(tmp_path / file, rig(BAG))


def test_text_loads_none_of_the_heavy_readers():
    code = (
        "import sys, labhil.recording, labhil.recording.export;"
        "heavy = {'pyarrow', 'openpyxl', 'h5py', 'rosbags', 'scipy'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
