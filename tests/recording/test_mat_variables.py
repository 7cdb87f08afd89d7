"""MAT files of others: scopes, struct arrays, cells, objects; what is not used is named with its reason."""

import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from labhil.errors import TableError
from labhil.recording import describe_import, import_table, read_recording, write_import
from labhil.rig import parse_rig

T = np.arange(30)[:, None] / 10
X, U = T**2, np.sin(T)


def rig(text="", kind="ball_beam"):
    return parse_rig(f'[rig]\nkind = "{kind}"\n{text}', Path("rig.toml"))


def channels(t, x, u):
    return f'[channels]\nt={{column="{t}"}}\nball_position={{column="{x}"}}\nservo_angle={{column="{u}"}}\n'


def scope(t=T, x=X, u=U, labels=("ball_position", "servo_angle")):
    kinds = [("values", "O"), ("dimensions", "O"), ("label", "O"), ("title", "O")]
    signals = np.empty((1, 2), dtype=kinds)
    for k, (values, label) in enumerate(zip((x, u), labels, strict=True)):
        signals[0, k] = (values, np.array([[1.0]]), label, "")
    return {"time": t, "signals": signals, "blockName": "model/Scope"}


def as_v5(path, variables):
    savemat(path, variables, oned_as="column")
    return path


def as_v73(path, variables):
    """As MATLAB writes version 7.3: structs are groups, fields of struct arrays references."""

    def put(file, group, name, value):
        if isinstance(value, dict):
            item = group.create_group(name)
            item.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, inner in value.items():
                put(file, item, key, inner)
        elif isinstance(value, str):
            codes = np.array([[ord(c)] for c in value] or [[0]], dtype=np.uint16)
            group.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")
        elif value.dtype.names:
            item = group.create_group(name)
            item.attrs["MATLAB_class"] = np.bytes_("struct")
            for key in value.dtype.names:
                field = item.create_dataset(key, (value.size, 1), dtype=h5py.ref_dtype)
                for k, one in enumerate(value.ravel()):
                    place = f"{name}{key}{k}"
                    put(file, file.require_group("#refs#"), place, one[key])
                    field[k, 0] = file["#refs#"][place].ref
        else:
            item = group.create_dataset(name, data=np.asarray(value).T)
            item.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            put(file, file, name, value)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    return path


VERSIONS = {"v5": as_v5, "v7.3": as_v73}
PATHS = ("ScopeData.time", "ScopeData.signals(1).values", "ScopeData.signals(2).values")
ADDRESSES = {
    "labels and nothing else": "",
    "paths": channels(*PATHS),
    "paths counted from 0": channels(*(path.replace("(1)", "[0]").replace("(2)", ".1") for path in PATHS)),
    "labels": channels("time", "ball_position", "servo_angle"),
    "labels of a scope": channels("ScopeData.time", "ScopeData.ball_position", "ScopeData.servo_angle"),
}


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("address", ADDRESSES)
def test_the_signals_of_a_scope_are_found_by_path_and_by_label(tmp_path, version, address):
    path = VERSIONS[version](tmp_path / "a.mat", {"ScopeData": scope()})
    table = import_table(path, rig(ADDRESSES[address]))
    assert table.t == pytest.approx(T[:, 0])
    assert table.values == pytest.approx(np.hstack([U, X]))


@pytest.mark.parametrize("version", VERSIONS)
def test_every_variable_that_is_not_used_is_named_with_its_reason(tmp_path, version):
    variables = {
        "t": T, "ball_position": X, "servo_angle": U, "spare": T + 1.0,
        "slow": np.arange(7.0)[:, None], "mass": np.array([[0.2]]), "who": "me",
        "log": {"extra": np.ones((4, 3))},
    }  # fmt: skip
    table = import_table(VERSIONS[version](tmp_path / "a.mat", variables), rig())
    said = "\n".join(describe_import(table))
    assert "not used: slow (7×1, where the table has 30 rows)" in said
    assert "not used: mass (1×1, where the table has 30 rows)" in said
    assert "not used: log.extra (4×3, where the table has 30 rows)" in said
    assert "not used: who (text)" in said
    assert "not used: spare (no channel asks for it)" in said
    metadata = read_recording(write_import(table, tmp_path / "a.mcap")).metadata["import"]
    assert "slow" in " ".join(metadata.values())


@pytest.mark.parametrize("version", VERSIONS)
def test_the_rows_are_those_of_what_is_wanted(tmp_path, version):
    """Another log is longer, and has a time of its own."""
    long = np.arange(100.0)[:, None]
    variables = {"fast": {"time": long, "position": long, "more": long}, "slow": {"time": T, "x": X, "u": U}}
    path = VERSIONS[version](tmp_path / "a.mat", variables)
    table = import_table(path, rig('[channels]\nball_position={column="x"}\nservo_angle={column="slow.u"}\n'))
    assert (len(table), table.stream.rate) == (30, pytest.approx(10.0))
    with pytest.raises(TableError, match=r"one time, found slow\.time \(30×1\) and fast\.time \(100×1\)"):
        import_table(path, rig(channels("slow.time", "slow.x", "fast.position")))
    with pytest.raises(TableError, match=r"'slow.y'.*found the columns"):
        import_table(path, rig(channels("slow.time", "slow.y", "slow.u")))


def test_scopes_of_one_length_with_other_times_are_not_put_together(tmp_path):
    path = as_v5(tmp_path / "a.mat", {"a": scope(), "b": scope(t=2.0 * T, labels=("x", "u"))})
    with pytest.raises(TableError, match=r"found a\.time .* and b\.time .*, which differ; .*interp1"):
        import_table(path, rig(channels("a.time", "a.ball_position", "b.u")))
    assert import_table(path, rig(channels("b.time", "x", "u"))).t == pytest.approx(2.0 * T[:, 0])
    table = import_table(path, rig(channels("time", "a.ball_position", "servo_angle")))
    assert table.t == pytest.approx(T[:, 0])


def test_wide_signals_and_matrices_are_several_columns(tmp_path):
    wide = np.hstack([X, 2.0 * X])
    cube = np.stack([X.T, U.T])  # 2 × 1 × rows, as Simulink logs a matrix
    path = as_v5(tmp_path / "a.mat", {"s": scope(x=wide), "y": cube})
    table = import_table(path, rig(channels("time", "ball_position_1", "y_1")))
    assert table.values == pytest.approx(np.hstack([U, 2.0 * X]))


def test_cells_are_followed_by_their_braces(tmp_path):
    cell = np.empty((1, 2), dtype=object)
    cell[0, 0], cell[0, 1] = X, U
    path = as_v5(tmp_path / "a.mat", {"t": T, "log": cell})
    assert import_table(path, rig(channels("t", "log{1}", "log{2}"))).values == pytest.approx(
        np.hstack([U, X])
    )


def element(kind, body):
    return struct.pack("<II", kind, len(body)) + body.ljust(-(-len(body) // 8) * 8, b"\0")


def opaque(name, kind):
    """A variable as MATLAB saves an object: flags, name, MCOS, class, and a reference into the file."""
    reference = np.array([0xDD000000, 2, 1, 1, 1, 1], dtype="<u4")
    flags = element(6, struct.pack("<II", 13, 0))
    array = element(
        14, flags + element(5, struct.pack("<ii", 6, 1)) + element(1, b"") + element(6, reference.tobytes())
    )
    texts = b"".join(element(1, text.encode()) for text in (name, "MCOS", kind))
    return element(14, element(6, struct.pack("<II", 17, 0)) + texts + array)


def test_objects_are_named_with_what_to_do_in_matlab(tmp_path):
    path = as_v5(tmp_path / "a.mat", {"t": T, "ball_position": X, "servo_angle": U})
    path.write_bytes(path.read_bytes() + opaque("run1", "timetable") + opaque("y", "timeseries"))
    said = "\n".join(describe_import(import_table(path, rig())))
    assert (
        "not used: run1 (an object of the class timetable; in MATLAB: S = table2struct(timetable2table(run1)"
        in said
    )
    assert "not used: y (an object of the class timeseries; in MATLAB: S = struct('t', y.Time" in said
    with pytest.raises(TableError, match=r"'run1\.x', found the columns .*run1 is no column: an object of"):
        import_table(path, rig(channels("t", "run1.x", "servo_angle")))
    path = as_v5(tmp_path / "b.mat", {"who": "me"})
    path.write_bytes(path.read_bytes() + opaque("run1", "timetable"))
    with pytest.raises(TableError, match=r"columns of numbers, found who: text; run1: an object .*timetable"):
        import_table(path, rig())


def struct_of(name, fields):
    """A struct of one element as MATLAB saves it; ``fields`` are elements without a name."""
    names = b"".join(key.encode().ljust(32, b"\0") for key in fields)
    return element(14, b"".join((
        element(6, struct.pack("<II", 2, 0)), element(5, struct.pack("<ii", 1, 1)), element(1, name.encode()),
        element(5, struct.pack("<i", 32)), element(1, names), *fields.values(),
    )))  # fmt: skip


def test_objects_within_structs_are_named_by_their_path(tmp_path):
    path = as_v5(tmp_path / "a.mat", {"t": T, "ball_position": X, "servo_angle": U})
    kinds = {"run1": "timetable", "logs": "Simulink.SimulationData.Dataset"}
    path.write_bytes(
        path.read_bytes() + struct_of("out", {key: opaque("", kind) for key, kind in kinds.items()})
    )
    said = "\n".join(describe_import(import_table(path, rig())))
    assert "not used: out.run1 (an object of the class timetable; in MATLAB: S = table2struct(" in said
    assert "timetable2table(out.run1)" in said
    assert "not used: out.logs (an object of the class Simulink.SimulationData.Dataset" in said
    assert "V = out.logs{1}.Values" in said


def test_objects_of_version_7_3_are_no_numbers(tmp_path):
    path = as_v73(tmp_path / "a.mat", {"t": T, "ball_position": X, "servo_angle": U})
    with h5py.File(path, "r+") as file:
        item = file.create_dataset("run1", data=np.array([[0xDD000000, 2, 1, 1, 1, 1]], dtype=np.uint32))
        item.attrs["MATLAB_class"] = np.bytes_("timetable")
        item.attrs["MATLAB_object_decode"] = np.int32(3)
    table = import_table(path, rig())
    assert any("not used: run1 (an object of the class timetable" in line for line in describe_import(table))
