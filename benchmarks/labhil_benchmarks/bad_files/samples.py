"""Whole files of every kind that a command reads, small, and each read by its command as it is."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

import labhil as lh

ROOT = Path(__file__).parents[3]
COUNT = 40
NAMES = ("t", "servo_angle", "ball_position")
T = np.arange(COUNT) / 20.0
ROWS = np.column_stack([T, 0.4 * np.sin(3.0 * T), 0.1 * np.sin(2.0 * T)])

RIG = """[rig]
kind = "ball_beam"
[known]
ball_mass = 0.261
ball_radius = 0.02
crank_radius = 0.08
beam_length = 0.4
[nominal]
viscous_friction.coefficient = 0.1
[limits]
servo_angle = { min = -1.2, max = 1.2, rate = 12.0 }
ball_position = { min = -0.24, max = 0.24 }
[interlocks]
ball_position = { trip_above = 0.2, resume_below = 0.1, then = "abort" }
[metric]
horizon = 4.0
[table]
header = true
skip_rows = 0
bad_rows = "drop"
[channels]
t = { column = "t", scale = 1.0 }
servo_angle = { column = 1, hold = "zero" }
ball_position = { column = "ball_position", scale = 1.0, offset = 0.0 }
"""
PLAIN_RIG = '[rig]\nkind = "ball_beam"\n[table]\nbad_rows = "drop"\n'
EXPERIMENT = """[experiment]
name = "two-sine"
seed = 1
[devices.bench]
plugin = "ball_beam"
address = "twin"
rig = "rig.toml"
twin = { speed = 1.0, seed = 3, terms = ["viscous_friction"] }
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "multisine"
frequencies = [0.23, 0.31]
amplitude = 0.2
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
duration = 6.0
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "file"
path = "input.csv"
duration = 1.9
[record]
path = "{name}-{start}.mcap"
"""
ARM = """<mujoco model="rod">
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="rod" pos="0 0 1">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.01" range="-3 3"/>
      <inertial pos="0 0 -0.1" mass="0.4" diaginertia="0.015 0.015 1e-3"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01"/>
    </body>
  </worldbody>
  <actuator><motor name="servo_angle" joint="hinge" ctrlrange="-1 1" gear="1"/></actuator>
  <sensor><jointpos name="ball_position" joint="hinge"/></sensor>
</mujoco>
"""
URDF = """<?xml version="1.0"?>
<robot name="rod">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.1" rpy="0 0 0"/><mass value="0.4"/>
    <inertia ixx="0.015" ixy="0" ixz="0" iyy="0.015" iyz="0" izz="0.001"/></inertial></link>
  <joint name="ball_position" type="revolute"><parent link="base"/><child link="rod"/>
    <origin xyz="0 0 1" rpy="0 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="10"/><dynamics damping="0.01" friction="0"/></joint>
</robot>
"""
FORCES = "coil_current,plunger_position,magnetic_force\n" + "".join(
    f"{i / 4},{x / 1000},{i * i / (1 + x)}\n" for i in range(5) for x in range(5)
)
LINKS = "".join(
    f"[[joint]]\nd = {d}\na = {a}\nalpha = {alpha}\nmass = 2.0\ncentre = [0.0, 0.1, 0.0]\n"
    "inertia = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]\n"
    for d, a, alpha in [
        (0.0892, 0.0, 1.5708), (0, -0.425, 0), (0, -0.392, 0), (0.109, 0, 1.5708), (0.0947, 0, -1.5708),
        (0.0823, 0, 0),
    ]
)  # fmt: skip
BENCH = "std_msgs/Header header\nfloat64 position\nfloat64[] raw\nstring note\n"
BAG_RIG = (
    '[rig]\nkind = "ball_beam"\n[channels]\nball_position = { column = "/bench/state.position" }\n'
    'servo_angle = { column = "/bench/state.raw[0]" }\n'
)


def comma_text() -> str:
    """A table with a header, and commas."""
    return ",".join(NAMES) + "\n" + "".join(f"{a:.6f},{b:.6f},{c:.6f}\n" for a, b, c in ROWS.tolist())


def input_text() -> str:
    """A table that drives a step of an experiment."""
    return "t,servo_angle\n" + "".join(f"{a:.6f},{b:.6f}\n" for a, b, _ in ROWS.tolist())


def semicolon_text() -> str:
    """A table as a spreadsheet in German writes it, with dates and quotation marks."""
    lines = [";".join((*NAMES, "note"))]
    for a, b, c in ROWS.tolist():
        cells = [f"2026-05-31T10:00:{a:06.3f}", f"{b:.6f}".replace(".", ","), f'"{c:.6f}"'.replace(".", ",")]
        lines.append(";".join((*cells, '"a; ""b"""')))
    return "\r\n".join(lines)


@cache
def tables() -> dict[str, bytes]:
    """Whole tables in every format but text, by file name."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _workbook(folder / "a.xlsx")
        _parquets(folder)
        _mats(folder)
        return {path.name: path.read_bytes() for path in folder.iterdir()}


def _workbook(path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    for row in ([*NAMES, "note"], *([*row, "x & y"] for row in ROWS.tolist())):
        book.active.append(row)
    book.save(path)


def _parquets(folder: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    columns: dict[str, Any] = {name: ROWS[:, k] for k, name in enumerate(NAMES)}
    pyarrow.parquet.write_table(pyarrow.table(columns), folder / "plain.parquet")
    more = {
        "t": pyarrow.array((T * 1e9).astype(np.int64), pyarrow.timestamp("ns")),
        "note": ["a", None] * (COUNT // 2),
        "list": [[1.0, 2.0]] * COUNT,
    }
    table = pyarrow.table({**columns, **more})
    pyarrow.parquet.write_table(table, folder / "packed.parquet", compression="zstd", row_group_size=15)


def _mats(folder: Path) -> None:
    import h5py
    from scipy.io import savemat

    columns = {name: ROWS[:, [k]] for k, name in enumerate(NAMES)}
    savemat(folder / "four.mat", columns, format="4")
    savemat(folder / "five.mat", columns, do_compression=False)
    struct = {"time": T, "signals": {"values": ROWS, "label": "x"}}
    more = {"names": np.array(["a", "b"], dtype=object), "scope": struct, "flag": True, "z": 1j}
    savemat(folder / "packed.mat", {**columns, **more}, do_compression=True)
    with h5py.File(folder / "seven.mat", "w", userblock_size=512) as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values.T, compression="gzip", chunks=(1, 20))
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("cell", data=np.array([[file["t"].ref]], dtype=h5py.ref_dtype))
    with (folder / "seven.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))


@cache
def bags() -> dict[str, dict[str, bytes]]:
    """The files of whole ROS 2 bags: by ``mcap`` and ``sqlite3``."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(BENCH, "bench_msgs/msg/Bench"))
    bench, header, time = (
        store.types[kind]
        for kind in ("bench_msgs/msg/Bench", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    files = {}
    for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "bag"
            with Writer(folder, version=9, storage_plugin=plugin) as writer:
                connection = writer.add_connection("/bench/state", bench.__msgtype__, typestore=store)
                for t, u, x in ROWS.tolist():
                    stamp = round((1.6e9 + t) * 1e9)
                    message_header = header(stamp=time(*divmod(stamp, 10**9)), frame_id="")
                    message = bench(message_header, x, np.array([u, 2.0 * u]), "x")
                    writer.write(connection, stamp, store.serialize_cdr(message, bench.__msgtype__))
            files[plugin.name.lower()] = {path.name: path.read_bytes() for path in folder.iterdir()}
    return files


@cache
def recordings() -> dict[str, bytes]:
    """Whole recordings: an imported table, and a piece of one by a run, with events and attachments."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.toml").write_text(RIG, encoding="utf-8")
        path = lh.recording(
            ROWS[:, 0], {"servo_angle": ROWS[:, 1]}, {"ball_position": ROWS[:, 2]}, rig=folder / "rig.toml"
        ).save(folder / "a.mcap")
        imported = Path(path).read_bytes()
    return {"imported": imported, "run": _shorten(ROOT / "recordings" / "ball_beam_test.mcap")}


def _shorten(path: Path) -> bytes:
    """The descriptions, attachments and first messages of a recording, as mcap's own writer packs them."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    out = BytesIO()
    with path.open("rb") as file:
        reader = make_reader(file)
        writer = Writer(out, chunk_size=4000)
        writer.start(profile="")
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time, attachment.log_time, attachment.name, attachment.media_type,
                attachment.data,
            )  # fmt: skip
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        channels: dict[int, int] = {}
        counts: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                number = (
                    0 if schema is None else writer.register_schema(schema.name, schema.encoding, schema.data)
                )
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, number, channel.metadata
                )
            counts[channel.id] = counts.get(channel.id, 0) + 1
            if counts[channel.id] <= COUNT:
                writer.add_message(
                    channels[channel.id], message.log_time, message.data, message.publish_time,
                    message.sequence,
                )  # fmt: skip
        writer.finish()
    return out.getvalue()


@cache
def results() -> dict[str, Any]:
    """Whole results as trees: a fit and a diagnosis."""
    folder = ROOT / "tests" / "tui" / "results"
    return {
        what: json.loads((folder / f"ball_beam_identify.{what}.json").read_text(encoding="utf-8"))
        for what in ("fit", "diagnosis")
    }


def whole_recording() -> bytes:
    """A recording that is long enough to be fitted."""
    return (ROOT / "recordings" / "ball_beam_test.mcap").read_bytes()


@cache
def fittable() -> dict[str, bytes]:
    """Recordings of a solenoid and of an arm that are long enough to be fitted, without rig files."""
    t = np.arange(400) / 500.0
    plunger = lh.recording(
        t,
        {"coil_current": 0.5 + 0.2 * np.sin(30.0 * t)},
        {"plunger_position": 0.002 + 0.0005 * np.sin(30.0 * t)},
        rig="solenoid",
    )
    t = np.arange(1500) / 50.0
    rates = 1.0 + 0.3 * np.arange(6)
    q, qd = 0.5 * np.sin(rates * t[:, None]), 0.5 * rates * np.cos(rates * t[:, None])
    arm = lh.recording(t, {"actual_q": q, "actual_qd": qd}, {"actual_current": q + qd}, rig="ur5")
    with tempfile.TemporaryDirectory() as name:
        saved = {
            kind: recording.save(Path(name) / f"{kind}.mcap")
            for kind, recording in (("solenoid", plunger), ("ur5", arm))
        }
        return {kind: Path(path).read_bytes() for kind, path in saved.items()}


@cache
def fmu() -> bytes | None:
    """An FMU of a pendulum, built here; None without a C compiler."""
    if shutil.which("cc") is None:
        return None
    built: Callable[..., Path] = _builder()
    with tempfile.TemporaryDirectory() as name:
        changes = {"angle": "ball_position", "torque": "servo_angle"}
        return built(Path(name), version=2, kinds="me cs", **changes).read_bytes()


def _builder() -> Callable[..., Path]:
    """What builds the FMU of the tests."""
    import importlib.util

    spec = importlib.util.spec_from_file_location(
        "pendulum_fmu", ROOT / "examples" / "fmu" / "pendulum_fmu.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    builder: Callable[..., Path] = module.built
    return builder
