"""The tables of others: every rule of [table] and [channels], and every way in which a table can be bad."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from labhil.errors import RecordingError, TableError, UsageError
from labhil.recording import (
    RecordingWriter,
    describe_import,
    export,
    export_csv,
    import_table,
    read_recording,
    write_import,
)
from labhil.recording.timeline import increasing_stretches
from labhil.rig import parse_rig

HEAD = '[rig]\nkind = "ball_beam"\n'
PLAIN = "t,ball_position,servo_angle\n0.0,0.1,0.2\n0.1,0.11,0.21\n0.2,0.12,0.22\n"


def rig(text=""):
    return parse_rig(HEAD + text, Path("rig.toml"))


def imported(folder, content, toml="", name="data.csv"):
    path = folder / name
    if isinstance(content, str):
        path.write_text(content, encoding="utf-8")
    else:
        path.write_bytes(content)
    return import_table(path, rig(toml))


def rows_of(table):
    return np.column_stack([table.t, *(table.values[:, i] for i in range(table.stream.width))]).tolist()


def test_columns_that_bear_our_names_need_no_mapping(tmp_path):
    table = imported(tmp_path, PLAIN)
    assert table.stream.names() == ("servo_angle", "ball_position")
    assert table.t == pytest.approx([0.0, 0.1, 0.2])
    assert table.values.tolist() == [[0.2, 0.1], [0.21, 0.11], [0.22, 0.12]]
    assert table.stream.rate == pytest.approx(10.0)
    assert not any(table.dropped.values())


@pytest.mark.parametrize("time", ["t", "time", "timestamp"])
def test_the_time_column_has_three_names(tmp_path, time):
    table = imported(tmp_path, PLAIN.replace("t,", f"{time},", 1))
    assert table.t == pytest.approx([0.0, 0.1, 0.2])


def test_channels_by_name_and_number_with_scale_and_offset(tmp_path):
    table = imported(
        tmp_path,
        "time_ms;note;pot_mm;deg\n100;a;10;1\n110;b;11;2\n120;c;12;3\n",
        """
        [channels]
        t = { column = "time_ms", scale = 1e-3 }
        ball_position = { column = "pot_mm", scale = 1e-3, offset = 0.5 }
        servo_angle = { column = 3, scale = 2.0 }
        """,
    )
    assert table.t == pytest.approx([0.0, 0.01, 0.02])
    assert table.time_origin == pytest.approx(0.1)
    assert table.values == pytest.approx(np.array([[2.0, 0.51], [4.0, 0.511], [6.0, 0.512]]))


DIALECTS = {
    "comma": ("{}", ",", "data.csv"),
    "semicolon in .csv": ("{}", ";", "data.csv"),
    "tab": ("{}", "\t", "data.tsv"),
    "tab by content": ("{}", "\t", "data.log"),
    "blanks": ("  {}", "   ", "data.dat"),
    "blanks and a tab at the end": ("  {}\t", "\t ", "data.dat"),
    "quoted": ('"{}"', ",", "data"),
    "windows": ("{}\r", ",", "data.txt"),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_delimiter_is_told_by_extension_and_content(tmp_path, dialect):
    line, delimiter, name = DIALECTS[dialect]
    if dialect == "quoted":
        delimiter = '","'
    content = "".join(line.format(delimiter.join(row.split(","))) + "\n" for row in PLAIN.split())
    assert rows_of(imported(tmp_path, content, name=name)) == rows_of(imported(tmp_path, PLAIN))


def test_a_header_with_blanks_in_its_names_is_tab_separated(tmp_path):
    content = "time (s)\tbeam angle\tball at\n0\t1\t2\n1\t2\t3\n"
    table = imported(
        tmp_path,
        content,
        '[channels]\nt = {column="time (s)"}\nbeam_angle = {column="beam angle"}\nball_position = {column=2}',
        "data.dat",
    )
    assert table.values.tolist() == [[1.0, 2.0], [2.0, 3.0]]


def test_decimal_comma_skipped_rows_and_comments(tmp_path):
    content = (
        "Instrument 7\nserial; 12\n% names\nt;ball_position;servo_angle\n\n0,0;0,1;0,2 % first\n1,0;0,3;0,4\n"
    )
    table = imported(tmp_path, content, '[table]\ndecimal = ","\nskip_rows = 2\ncomment = "%"')
    assert rows_of(table) == [[0.0, 0.2, 0.1], [1.0, 0.4, 0.3]]


def test_latin_1_and_utf_16_and_a_byte_order_mark(tmp_path):
    content = PLAIN.replace("t,ball", "t,Länge,ball").replace(",0.", ",9,0.", 1)
    content = "t,Länge,ball_position,servo_angle\n0,9,1,2\n1,9,3,4\n"
    expected = [[0.0, 2.0, 1.0], [1.0, 4.0, 3.0]]
    for encoding in ("utf-8", "utf-8-sig", "latin-1", "utf-16"):
        assert rows_of(imported(tmp_path, content.encode(encoding))) == expected


NUMBERED = """
[table]
rate = 10.0
[channels]
beam_angle = { column = 0 }
ball_position = { column = 1 }
"""


def test_without_a_time_column_rows_come_at_the_rate_and_a_dropped_row_leaves_a_hole(tmp_path):
    table = imported(tmp_path, "1 2\n3 4\noops 6\n\n7 8\n", NUMBERED, "data.txt")
    assert table.t == pytest.approx([0.0, 0.1, 0.3])
    assert table.row.tolist() == [0, 1, 3]
    assert table.dropped == {"field_count": 0, "not_finite": 1, "time": 0}


def test_a_time_column_goes_before_a_rate(tmp_path):
    table = imported(tmp_path, PLAIN, "[table]\nrate = 1.0")
    assert table.t == pytest.approx([0.0, 0.1, 0.2])


def test_a_first_row_with_text_in_it_is_a_bad_row_and_no_header(tmp_path):
    table = imported(tmp_path, "oops 2\n3 4\n5 6\n", NUMBERED)
    assert (table.rows, len(table)) == (3, 2)


def test_a_header_is_told_by_the_names_that_are_asked_for(tmp_path):
    toml = '[table]\nrate = 1\n[channels]\nbeam_angle = {column="1"}\nball_position = {column="b"}'
    assert imported(tmp_path, "1,b\n3,4\n5,6\n", toml).values.tolist() == [[3.0, 4.0], [5.0, 6.0]]


def test_header_false_takes_the_first_row_as_data(tmp_path):
    table = imported(tmp_path, "a b\n3 4\n5 6\n", NUMBERED.replace("[table]", "[table]\nheader = false"))
    assert table.dropped["not_finite"] == 1


BAD = "t,ball_position,servo_angle,note\n" + "".join(f"{i / 10},{i},{-i},x\n" for i in range(20))


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("0.95,1,2", "field_count"),
        ("0.95,1,2,x,y", "field_count"),
        ("0.95,nan,2,x", "not_finite"),
        ("0.95,inf,2,x", "not_finite"),
        ("0.95,,2,x", "not_finite"),
        ("0.95,lost,2,x", "not_finite"),
        ("soon,1,2,x", "not_finite"),
        ("0.9,1,2,x", "time"),
        ("0.2,1,2,x", "time"),
        ("1e9,1,2,x", "time"),
        ("3.0,1,2,x", "time"),
    ],
)
def test_a_bad_row_is_dropped_and_counted_or_refused_with_its_line(tmp_path, row, reason):
    lines = BAD.splitlines()
    lines.insert(11, row)
    content = "\n".join(lines)
    table = imported(tmp_path, content)
    assert {key: count for key, count in table.dropped.items() if count} == {reason: 1}
    assert len(table) == 20
    assert any("dropped: 1 rows" in line for line in describe_import(table))
    with pytest.raises(TableError, match=r"line 1[123]"):
        imported(tmp_path, content, '[table]\nbad_rows = "fail"')


def test_text_in_columns_that_are_not_mapped_is_nobodys_business(tmp_path):
    assert len(imported(tmp_path, BAD, '[table]\nbad_rows = "fail"')) == 20


def test_the_longest_part_stays_when_the_clock_was_set_and_bad_rows_are_dropped(tmp_path):
    one = "".join(f"{i / 10},1,2\n" for i in range(30))
    two = "".join(f"{i / 10 + 0.03},3,4\n" for i in range(50))
    content = "t,ball_position,servo_angle\n" + one + two
    table = imported(tmp_path, content, '[table]\nbad_rows = "drop"')
    assert len(table) == 50
    assert set(table.values[:, 1]) == {3.0}
    assert table.dropped["part"] == 30
    with pytest.raises(TableError, match=r"line 32 .*\[table\] part"):
        imported(tmp_path, content)


@pytest.mark.parametrize("gap", [9.9, 10.3, 1e4])
def test_a_gap_loses_no_rows(tmp_path, gap):
    times = [i / 10 for i in range(20)] + [1.9 + gap + i / 10 for i in range(40)]
    table = imported(tmp_path, "t,ball_position,servo_angle\n" + "".join(f"{t:.6f},1,2\n" for t in times))
    assert len(table) == 60


@settings(max_examples=60, deadline=None)
@given(
    st.integers(40, 250),
    st.lists(
        st.tuples(st.integers(0, 249), st.sampled_from([-1e9, -30.0, -0.5, 5.0, 60.0, 1e9])), max_size=4
    ),
    st.lists(st.tuples(st.integers(20, 249), st.sampled_from([20.0, 5000.0])), max_size=2),
)
def test_wrong_stamps_are_jumped_over_and_holes_are_not(n, struck, holes):
    times = np.arange(n, dtype=float)
    for place, length in holes:
        times[place:] += length
    wrong = {place % n for place, _ in struck}
    for place, error in struck:
        times[place % n] += error
    runs = increasing_stretches(times)
    kept = np.concatenate(runs)
    for run in runs:
        assert (np.diff(run) > 0).all()
        assert (np.diff(times[run]) > 0).all()
    # beside a wrong stamp, or at the short end that it cuts off, neighbours may go with it
    assert n - len(kept) <= 4 * len(wrong)


def test_values_outside_the_limits_stay_and_are_flagged(tmp_path):
    table = imported(tmp_path, BAD, "[limits]\nball_position = { min = -2, max = 4 }")
    assert len(table) == 20
    assert table.outside == {"ball_position": 15}
    assert table.flagged.tolist() == [i > 4 for i in range(20)]
    assert any("outside [limits], kept: 15 rows of ball_position" in line for line in describe_import(table))


CASES = {
    "empty": ("", "", "found an empty file"),
    "only blanks": ("\n  \n", "", "found an empty file"),
    "only a header": ("t,ball_position,servo_angle\n", "", "no rows below it"),
    "one row": ("t,ball_position,servo_angle\n0,1,2\n", "", "two good rows or more"),
    "all skipped": (PLAIN, "[table]\nskip_rows = 9", "no rows"),
    "no output": (
        "t,ball_positon,servo_angle\n0,1,2\n",
        "",
        r"did you mean 'ball_positon'.*found the columns t",
    ),
    "no input": ("t,ball_position\n0,1\n", "", "an input is missing: expected servo_angle or beam_angle"),
    "input not mapped": (
        PLAIN,
        "[channels]\nball_position = {column=1}",
        r"expected servo_angle or beam_angle in \[channels\] of rig.toml, found ball_position",
    ),
    "no time": ("ball_position,servo_angle\n1,2\n3,4\n", "", r"no time: .*\[table\] rate"),
    "no such name": (
        PLAIN,
        '[channels]\nball_position = {column="ball_possition"}\nservo_angle={column=2}',
        r"expected a column 'ball_possition' \(did you mean 'ball_position'\?\), found the columns t, ball_",
    ),
    "no such number": (
        PLAIN,
        "[channels]\nball_position = {column=7}\nservo_angle={column=2}",
        "expected a column 7, found the columns",
    ),
    "no header": (
        "1 2\n3 4\n",
        '[table]\nrate=1\n[channels]\nball_position = {column="x"}\nbeam_angle={column=0}',
        "found no header and 2 columns, 0 to 1",
    ),
    "a name twice": ("t,ball_position,ball_position,servo_angle\n0,1,1,2\n1,1,1,2\n", "", "found several"),
    "text everywhere": (
        "t,ball_position,servo_angle\n0,a,1\n1,b,1\n",
        "",
        r"line 2: column 'ball_position' \(ball_position\): expected a finite number, found 'a'",
    ),
    "decimal comma unsaid": ("t;ball_position;servo_angle\n0,0;1,0;2,0\n0,1;1,0;2,0\n", "", 'decimal = ","'),
    "never all at once": ("t,ball_position,servo_angle\n0,1,\n1,,1\n", "", "finite numbers in all mapped"),
    "header of another width": ("t,ball_position,servo_angle\n0,1,1,\n1,1,1,\n", "", "expected 3 fields"),
    "delimiter and decimal": (PLAIN, '[table]\ndelimiter = "comma"\ndecimal = ","', "must differ"),
    "nanoseconds": (
        "t,ball_position,servo_angle\n" + "".join(f"{i}e17,1,1\n" for i in range(9)),
        "",
        "can have a scale",
    ),
    "nanoseconds of a clock": (
        "t,ball_position,servo_angle\n" + "".join(f"{17 * 10**17 + i * 10**7},1,1\n" for i in range(1500)),
        "",
        "with scale = 1e-09 they span 14.99 s",
    ),
    "too many columns": (
        PLAIN,
        "[channels]\nball_position = {columns=[1,2]}\nservo_angle={column=2}",
        "channels.ball_position: expected 1 columns, found 2",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_table_that_cannot_be_read_is_refused_in_words(tmp_path, case):
    content, toml, message = CASES[case]
    with pytest.raises(TableError, match=message) as caught:
        imported(tmp_path, content, toml)
    assert "data.csv" in str(caught.value) or "rig.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"\x89MCAP0\r\n...", "expected a whole MCAP file, found one that cannot be read"),
        (b"PAR1....", "expected a Parquet file, found one that cannot be read"),
        (b"PK\x03\x04....", "XLSX.*cut or damaged"),
        (b"\x89HDF....", "expected an HDF5 file, found one that cannot be read"),
        (b"MATLAB 7.3 MAT-file, cut", "expected an HDF5 file"),
        (b"SQLite format 3\x00", "to end in .db3"),
        (b"\xd0\xcf\x11\xe0....", "save it as .xlsx"),
        (b"\x1f\x8b\x08....", "unpack it first"),
        (b"#ROSBAG V2.0", "rosbags-convert"),
        (b"ARROW1..", "save it as Parquet"),
        (b"\x7fELF\x00\x00", "a binary file"),
        (b"MATLAB 5.0 MAT-file, cut", "MAT file"),
    ],
)
def test_files_of_other_kinds_are_named(tmp_path, content, found):
    with pytest.raises(TableError, match=found):
        imported(tmp_path, content)


def test_a_missing_file_is_named():
    with pytest.raises(TableError, match=r"nowhere\.csv: cannot be read: there is no such file"):
        import_table(Path("nowhere.csv"), rig())


def test_a_cut_file_loses_its_last_row(tmp_path):
    table = imported(tmp_path, PLAIN[:-6])
    assert len(table) == 2
    assert table.dropped["field_count"] == 1


def test_mat_variables_are_columns(tmp_path):
    path = tmp_path / "data.mat"
    t = np.arange(50) / 50
    savemat(path, {"time": t, "pos": np.sin(t)[:, None], "u": np.vstack([t, 2 * t]), "fs": 50.0, "who": "me"})
    mapping = """
    [channels]
    t = { column = "time" }
    ball_position = { column = "pos" }
    servo_angle = { column = "u_1", scale = 2 }
    """
    table = import_table(path, rig(mapping))
    assert np.array_equal(table.values, np.column_stack([4 * t, np.sin(t)]))
    with pytest.raises(TableError, match=r"did you mean 'u_0'.*found the columns time, pos, u_0, u_1"):
        import_table(path, rig('[channels]\nball_position={column="pos"}\nservo_angle={column="u0"}'))


def test_a_mat_file_without_columns_is_refused(tmp_path):
    path = tmp_path / "data.mat"
    savemat(path, {"who": "me"})
    with pytest.raises(TableError, match="expected variables that are columns"):
        import_table(path, rig())


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_numbers_in_any_dialect_come_through_as_they_are(tmp_path, data):
    delimiter, token = data.draw(
        st.sampled_from([("comma", ","), ("semicolon", ";"), ("tab", "\t"), ("whitespace", "  ")])
    )
    decimal = data.draw(st.sampled_from([".", ","] if delimiter != "comma" else ["."]))
    finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
    rows = data.draw(st.lists(st.tuples(finite, finite), min_size=2, max_size=30))
    names = data.draw(st.permutations(["t", "ball_position", "servo_angle"]))
    told = data.draw(st.booleans())
    lines = [token.join(names)]
    for number, (x, u) in enumerate(rows):
        fields = {"t": repr(number / 8), "ball_position": repr(x), "servo_angle": repr(u)}
        lines.append(token.join(fields[name].replace(".", decimal) for name in names))
        if data.draw(st.booleans()):
            lines.append(data.draw(st.sampled_from(["", "  "])))
    toml = f'[table]\ndecimal = "{decimal}"\n' + (f'delimiter = "{delimiter}"\nheader = true' if told else "")
    table = imported(tmp_path, "\n".join(lines), toml, "data.txt")
    assert table.values.tolist() == [[u, x] for x, u in rows]
    assert table.t.tolist() == [number / 8 for number in range(len(rows))]


def test_an_import_becomes_a_recording_that_tells_where_it_came_from(tmp_path):
    lines = BAD.splitlines()
    lines.insert(11, "0.95,lost,2,x")
    toml = "[limits]\nball_position = { min = -2, max = 4 }\n"
    table = imported(tmp_path, "\n".join(lines), toml)
    out = write_import(table, tmp_path / "rec.mcap")
    recording = read_recording(out)
    data = recording.stream_with("ball_position")
    assert recording.rig.text == table.rig.text
    assert recording.rig.limits == table.rig.limits
    assert recording.complete
    assert (data.device, data.stream.name, data.lost) == ("ball_beam", "state", 1)
    assert np.array_equal(data.values, table.values)
    assert data.t == pytest.approx(table.t, abs=1e-12)
    told = recording.metadata["import"]
    assert (told["rows"], told["kept"], told["dropped.not_finite"]) == ("21", "20", "1")
    assert told["outside_limits.ball_position"] == "15"
    assert (told["source"], told["sha256"]) == ("data.csv", table.sha256)
    again = write_import(table, tmp_path / "again.mcap")
    assert read_recording(again).sha256 == recording.sha256
    with pytest.raises(RecordingError, match="expected a new file"):
        write_import(table, out)


def test_what_is_exported_is_imported_as_it_was(tmp_path):
    table = imported(tmp_path, PLAIN)
    recording = read_recording(write_import(table, tmp_path / "rec.mcap"))
    out = export(recording, tmp_path / "out.csv")
    assert out.read_text().splitlines()[0] == "t,servo_angle,ball_position"
    again = import_table(out, rig())
    assert np.array_equal(again.values, table.values)
    assert np.array_equal(again.t, recording.streams[0].t)


def test_exports_that_cannot_be_are_refused_in_words(tmp_path):
    recording = read_recording(write_import(imported(tmp_path, PLAIN), tmp_path / "rec.mcap"))
    with pytest.raises(UsageError, match=r"expected an extension \.csv, .*, found '\.xls'"):
        export(recording, tmp_path / "out.xls")
    with pytest.raises(UsageError, match="cannot be written"):
        export_csv(recording, tmp_path / "nowhere" / "out.csv")
    with RecordingWriter(tmp_path / "empty.mcap") as writer:
        writer.metadata("nothing", {})
    with pytest.raises(RecordingError, match="expected one stream to export, found no streams at all"):
        export(read_recording(tmp_path / "empty.mcap"), tmp_path / "out.csv")


def test_the_daisy_bench_is_read(tmp_path):
    """A measured recording of others: no header, blanks and tabs, 10 Hz, beam angle and position."""
    shared = Path(os.environ.get("LABHIL_DATA", Path(__file__).parents[3] / "shared" / "data"))
    source = shared / "ball_beam_daisy" / "ballbeam.dat"
    if not source.exists():
        pytest.skip(f"{source} is not here; LABHIL_DATA names the folder that holds ball_beam_daisy")
    table = import_table(source, rig(NUMBERED))
    plain = np.loadtxt(source)
    assert np.array_equal(table.values, plain)
    assert not any(table.dropped.values())
    data = read_recording(write_import(table, tmp_path / "rec.mcap")).stream_with("ball_position")
    assert np.array_equal(data["beam_angle"], plain[:, 0])
    assert data.rate == pytest.approx(10.0)
    assert data.t == pytest.approx(np.arange(1000) / 10, abs=1e-9)
