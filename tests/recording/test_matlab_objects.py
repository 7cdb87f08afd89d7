"""Objects of MATLAB's own classes: timetables, tables, timeseries and the signals of a Simulink Dataset.

The files in ``matlab_objects`` are by mat-io 1.0.2, an independent writer: 30 rows at 10 Hz, ball_position is
t², servo_angle sin t. timetable, table and the times are as MATLAB keeps them. What timeseries and Datasets
call their properties comes from the definitions of these classes, not from a file that MATLAB saved.
"""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labhil.errors import LabhilError, TableError
from labhil.recording import describe_import, import_table
from labhil.recording.formats.matlab_mcos import Objects, UnknownObjectError
from labhil.recording.formats.variables import Node
from labhil.rig import parse_rig

FILES = Path(__file__).parent / "matlab_objects"
T = np.arange(30) / 10
EXPECTED = np.column_stack([np.sin(T), T**2])


def rig(t="", x="", u=""):
    lines = [
        f'{signal} = {{ column = "{column}" }}\n'
        for signal, column in (("t", t), ("ball_position", x), ("servo_angle", u))
        if column
    ]
    text = f"[channels]\n{''.join(lines)}" if lines else ""
    return parse_rig(f'[rig]\nkind = "ball_beam"\n{text}', Path("rig.toml"))


WAYS = {
    "timetable": ("by_duration.Time", "by_duration.ball_position", "by_duration.servo_angle", 0.0),
    "its time is found": ("", "by_duration.ball_position", "by_duration.servo_angle", 0.0),
    "Dataset": ("", "logsout.ball_position", "logsout.servo_angle", 0.0),
    "Dataset by property": ("", "logsout.ball_position.Data", "logsout.servo_angle.Data", 0.0),
    "dates": ("by_date.Time", "by_date.ball_position", "by_date.servo_angle", 1772366400.0),
    "table": ("plain.t", "plain.ball_position", "plain.servo_angle", 0.0),
    "timeseries": ("x.Time", "x.Data", "u.Data", 0.0),
    "timeseries by variable": ("", "x", "u", 0.0),
}
IN_73 = ("timetable", "its time is found", "Dataset", "Dataset by property")


@pytest.mark.parametrize(("version", "way"), [*(("v7", w) for w in WAYS), *(("v73", w) for w in IN_73)])
def test_objects_are_columns_by_their_properties(version, way):
    t, x, u, origin = WAYS[way]
    table = import_table(FILES / f"objects_{version}.mat", rig(t, x, u))
    assert table.values == pytest.approx(EXPECTED)
    assert table.t == pytest.approx(T, abs=1e-6)
    assert table.time_origin == pytest.approx(origin)


def test_properties_of_other_classes_are_followed_by_name():
    table = import_table(
        FILES / "objects_v7.mat", rig("by_duration.Time", "mine.log.ball_position", "u.Data")
    )
    assert table.values == pytest.approx(EXPECTED)
    said = "\n".join(describe_import(table))
    assert "mine.gain (1×1, where the table has 30 rows)" in said


def test_objects_that_cannot_be_read_are_named_with_what_to_do_in_matlab(tmp_path):
    data = (FILES / "objects_v7.mat").read_bytes()
    (tmp_path / "a.mat").write_bytes(data[:128] + _variables_of(data))
    with pytest.raises(
        TableError, match="by_duration: an object of the class timetable; in MATLAB: S = table2"
    ):
        import_table(tmp_path / "a.mat", rig("", "by_duration.ball_position", "u.Data"))
    with pytest.raises(
        TableError,
        match=r"x: an object of the class timeseries; in MATLAB: S = struct\('t', x.Time, 'x', x.Data\)",
    ):
        import_table(tmp_path / "a.mat", rig("x.Time", "x.Data", "u.Data"))


def _variables_of(data):
    """All elements of a MAT file but the last, in which the objects are."""
    places, position = [], 128
    while position < len(data):
        places.append(position)
        position += 8 + int.from_bytes(data[position + 4 : position + 8], "little")
    return data[128 : places[-1]]


def metadata(names=("millis", "duration"), objects=((1, 0, 0, 0, 1, 1),), properties=((1, 1, 0),)):
    """The first cell by hand: one class, its objects, and the properties of each."""
    text = b"".join(name.encode() + b"\0" for name in names)
    text = text.ljust(-(-len(text) // 8) * 8, b"\0")
    classes = np.array([0, 0, 0, 0, 0, 2, 0, 0], "<u4").tobytes()
    rows = np.array([(0,) * 6, *objects], "<u4").tobytes()
    block = np.array([len(properties), *np.ravel(properties)], "<u4").tobytes()
    saved = bytes(8) + block.ljust(-(-len(block) // 8) * 8, b"\0")
    places = np.cumsum([40 + len(text), len(classes), 0, len(rows), len(saved), 0, 0, 0])
    head = np.array([4, len(names), *places], "<u4").tobytes()
    return head + text + classes + rows + saved


def test_a_reference_is_followed_and_a_wrong_one_is_refused():
    objects = Objects(metadata(), lambda number: Node(array=np.array([[2000.0 * number]])))
    assert objects.node([0xDD000000, 2, 1, 1, 1, 1]).array.tolist() == [[4.0]]
    for wrong in ([], [1, 2, 3, 4], [0xDD000000, 2, 1, 1, 7, 1], [0xDD000000, 99, 1, 1, 1, 1]):
        with pytest.raises(UnknownObjectError):
            objects.node(wrong)


def test_objects_that_hold_themselves_end():
    objects = Objects(metadata(("a", "Own")), lambda number: objects.node([0xDD000000, 2, 1, 1, 1, 1]))
    part = objects.node([0xDD000000, 2, 1, 1, 1, 1])
    for _ in range(100):
        part = part.fields.get("a", part)
    assert part.reason == "objects within objects without an end"


@settings(max_examples=100, deadline=None)
@given(
    data=st.binary(max_size=300), place=st.integers(0, 10**6), bits=st.integers(1, 255), whole=st.booleans()
)
def test_any_description_of_objects_is_read_or_refused(data, place, bits, whole):
    content = bytearray(metadata())
    content[place % len(content)] ^= bits
    try:
        objects = Objects(bytes(content) if whole else data, lambda number: Node(array=np.ones((1, 1))))
        objects.node([0xDD000000, 2, 1, 1, 1, 1])
    except UnknownObjectError as refused:
        assert str(refused)


@settings(max_examples=12, deadline=None)
@given(place=st.integers(128, 10**6), bits=st.integers(1, 255), version=st.sampled_from(["v7", "v73"]))
def test_a_damaged_file_is_read_or_refused_in_words(tmp_path_factory, place, bits, version):
    path = tmp_path_factory.mktemp("damaged") / "a.mat"
    data = bytearray((FILES / f"objects_{version}.mat").read_bytes())
    data[place % len(data)] ^= bits
    path.write_bytes(data)
    try:
        import_table(path, rig("", "by_duration.ball_position", "by_duration.servo_angle"))
    except LabhilError as refused:
        assert str(path) in str(refused)
