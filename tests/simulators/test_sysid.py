"""``mujoco.sysid`` itself writes what is imported, and reads and identifies what is exported.

Its trajectories need MuJoCo and absl's log, which is replaced here where it is not installed. Its optimizer
needs ``pip install 'mujoco[sysid]'``, and one test is skipped without it.
"""

from __future__ import annotations

import json
import logging
import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import labhil as lh
from labhil.command_line import app
from labhil.errors import LabhilError, TableError, UsageError
from labhil.recording import describe_import, import_table, read_recording
from labhil.recording.formats.npz import SysidColumns, read_npz
from labhil.rig import load_rig, parse_rig
from labhil.simulators.sysid_file import write_sysid

if find_spec("absl") is None:
    absl = ModuleType("absl")
    absl.logging = logging  # type: ignore[attr-defined]
    sys.modules["absl"] = absl
from mujoco.sysid._src.timeseries import SignalType, TimeSeries
from mujoco.sysid._src.trajectory import (
    ModelSequences,
    SystemTrajectory,
    create_initial_state,
    sysid_rollout,
)

FILE = (Path(__file__).parents[2] / "examples" / "pendulum.xml").read_text(encoding="utf-8")

RIG = """[model]
mujoco = "pendulum.xml"
inputs = { torque = "motor" }
outputs = { angle = "angle" }
"""
CHANNELS = '[channels]\ntorque = { column = "motor" }\nangle = { column = "angle" }\n'
MASS = 0.42
OUTSIDE = '{"a": [0, [7]]}'


def bench(folder: Path, xml: str = FILE, rig: str = RIG + CHANNELS) -> Path:
    (folder / "pendulum.xml").write_text(xml, encoding="utf-8")
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    return folder / "rig.toml"


def trajectory(folder: Path, mass: float = MASS, seconds: float = 3.0) -> SystemTrajectory:
    """A swing of the pendulum with another mass than the file's, measured every 10 ms."""
    spec = mujoco.MjSpec.from_string(FILE)
    spec.geoms[0].mass = mass
    model = spec.compile()
    steps = round(seconds / model.opt.timestep)
    times = np.arange(steps) * model.opt.timestep
    pushed = (0.5 * np.sin(2.0 * times) + 0.3 * np.sin(5.3 * times))[:, None]
    control = TimeSeries.from_control_names(times, pushed, model)
    start = create_initial_state(model, np.array([0.1]), np.array([0.0]))
    (rolled,) = sysid_rollout(model, mujoco.MjData(model), [control], [start])
    every = slice(None, None, 5)
    return SystemTrajectory(
        model=model,
        control=control,
        sensordata=TimeSeries.from_names(
            rolled.sensordata.times[every], rolled.sensordata.data[every], model
        ),
        initial_state=start,
        state=rolled.state,
    )


@pytest.mark.extended
def test_a_trajectory_of_sysid_is_imported(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    saved = trajectory(tmp_path)
    saved.save_to_disk(tmp_path / "run.npz")
    table = import_table(tmp_path / "run.npz", load_rig(rig))
    assert table.values[:, table.stream.columns_of("angle")][:, 0] == pytest.approx(
        saved.sensordata.data[: len(table), 0], abs=1e-12
    )
    expected = np.interp(table.t + table.time_origin, saved.control.times, saved.control.data[:, 0])
    assert table.values[:, table.stream.columns_of("torque")][:, 0] == pytest.approx(expected, abs=1e-9)
    lines = "\n".join(describe_import(table))
    assert "rows are the samples of sensordata; without a channel t the time is theirs" in lines
    assert "control has times of its own" in lines
    assert len(lh.read(tmp_path / "run.npz", rig=rig)) == len(table)


@pytest.mark.parametrize(
    ("angle", "torque"),
    [
        ("sensordata.angle", "control.motor_ctrl"),
        ("hinge_qpos", "motor_ctrl"),
        ("state.hinge_qpos", "control.motor"),
    ],
)
def test_signals_are_found_by_group_and_name(tmp_path: Path, angle: str, torque: str) -> None:
    saved = trajectory(tmp_path)
    saved.save_to_disk(tmp_path / "run.npz")
    columns = read_npz(tmp_path / "run.npz", [angle, torque])
    (place,) = columns.find(angle)
    group = saved.state if "qpos" in angle else saved.sensordata
    expected = group.data[:, 1] if "qpos" in angle else group.data[:, 0]
    assert columns.numbers(place) == pytest.approx(expected)
    assert len(columns.find(torque)) == 1
    assert columns.find("hinge") == columns.find("state.hinge_qpos") + columns.find("state.hinge_qvel")


def test_a_time_series_and_plain_arrays_are_imported(tmp_path: Path) -> None:
    t = np.arange(30) / 10
    rig = parse_rig('[rig]\nkind = "ball_beam"\n', Path("rig.toml"))
    series = TimeSeries.from_custom_map(
        t,
        np.column_stack([-t, t, t, t]),
        ["servo_angle", "ball_position", ("v", 2, SignalType.CustomObs)],
    )
    series.save_to_disk(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", t=t, servo_angle=-t, ball_position=t[:, None], other=np.array(["x"]), n=3)
    np.savez_compressed(tmp_path / "c.npz", t=t, servo_angle=-t, ball_position=t)
    mapped = parse_rig(
        f"{rig.text}[channels]\nball_position = {{ column = 'v[1]' }}\n"
        "servo_angle = { column = 'data.servo_angle' }\n",
        Path("rig.toml"),
    )
    named = parse_rig(
        f"{rig.text}[channels]\nball_position = {{ column = 'ball_position' }}\n"
        "servo_angle = { column = 'servo_angle' }\n",
        Path("rig.toml"),
    )
    for file, which in (("a", mapped), ("a", named), ("b", rig), ("c", rig)):
        table = import_table(tmp_path / f"{file}.npz", which)
        assert table.values == pytest.approx(np.column_stack([-t, t])), file
        assert table.t == pytest.approx(t)


def test_an_export_is_read_and_identified_by_sysid(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    trajectory(tmp_path).save_to_disk(tmp_path / "run.npz")
    command = CliRunner()
    run, out = tmp_path / "run.mcap", tmp_path / "out.npz"
    done = command.invoke(app, ["import", str(tmp_path / "run.npz"), "--rig", str(rig), "-o", str(run)])
    assert done.exit_code == 0, done.output
    done = command.invoke(app, ["export", str(run), "-o", str(out), "--rig", str(rig)])
    assert done.exit_code == 0, done.output
    assert "velocity at the start" in done.output
    spec = mujoco.MjSpec.from_file(str(tmp_path / "pendulum.xml"))
    back = SystemTrajectory.load_from_disk(out, spec.compile())
    recorded = read_recording(run).stream_with("angle")
    assert back.sensordata.data[:, 0] == pytest.approx(
        recorded.values[:, recorded.stream.columns_of("angle")][:, 0]
    )
    assert list(back.sensordata.signal_mapping) == ["angle"]
    assert list(back.control.signal_mapping) == ["motor_ctrl"]
    assert len(
        ModelSequences("p", spec, "run", back.initial_state, back.control, back.sensordata).measured_rollout
    )


@pytest.mark.skipif(
    find_spec("plotly") is None or find_spec("colorama") is None, reason="mujoco[sysid] is not installed"
)
def test_sysid_identifies_from_an_export(tmp_path: Path) -> None:
    from mujoco import sysid

    rig = bench(tmp_path)
    trajectory(tmp_path).save_to_disk(tmp_path / "run.npz")
    lh.read(tmp_path / "run.npz", rig=rig).save(tmp_path / "run.mcap")
    (data,) = read_recording(tmp_path / "run.mcap").streams
    out = write_sysid(data, load_rig(rig), tmp_path / "out.npz").path
    spec = mujoco.MjSpec.from_file(str(tmp_path / "pendulum.xml"))
    back = SystemTrajectory.load_from_disk(out, spec.compile())
    sequences = ModelSequences("pendulum", spec, "run", back.initial_state, back.control, back.sensordata)

    def set_mass(changed: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        changed.geoms[0].mass = parameter.value[0]

    parameters = sysid.ParameterDict()
    parameters.add(sysid.Parameter("mass", nominal=0.3, min_value=0.1, max_value=1.0, modifier=set_mass))
    residuals = sysid.build_residual_fn(models_sequences=[sequences])
    found, _ = sysid.optimize(initial_params=parameters, residual_fn=residuals, verbose=False)
    assert found["mass"].value[0] == pytest.approx(MASS, rel=0.03)


def test_an_export_states_what_it_needs(tmp_path: Path) -> None:
    rig = bench(tmp_path, rig=RIG.replace('"motor"', '"hinge"') + CHANNELS)
    trajectory(tmp_path).save_to_disk(tmp_path / "run.npz")
    run = tmp_path / "run.mcap"
    command = CliRunner()
    assert (
        command.invoke(
            app, ["import", str(tmp_path / "run.npz"), "--rig", str(rig), "-o", str(run)]
        ).exit_code
        == 0
    )
    shipped = tmp_path / "shipped.toml"
    shipped.write_text('[rig]\nkind = "ball_beam"\n')
    for more, expected in (
        ([], "found no --rig"),
        (["--rig", str(shipped)], "found a rig of the kind 'ball_beam'"),
        (["--rig", str(rig)], "add <motor joint"),
    ):
        done = command.invoke(app, ["export", str(run), "-o", str(tmp_path / "out.npz"), *more])
        assert isinstance(done.exception, UsageError)
        assert expected in str(done.exception)
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"times": np.arange(3.0), "data": np.zeros((4, 1))}, r"times of shape \(n,\).*\(3,\) and \(4, 1\)"),
        ({"times": np.array(["a"]), "data": np.zeros((1, 1))}, "expected numbers in times and data"),
        (
            {"times": np.arange(3.0), "data": np.zeros((3, 1)), "signal_mapping": np.asarray("[")},
            "expected JSON",
        ),
        (
            {"times": np.arange(3.0), "data": np.ones((3, 1)), "signal_mapping": np.asarray(OUTSIDE)},
            "a: expected indices from 0 to 0",
        ),
        ({"x": np.array([{}], dtype=object)}, "columns of numbers, found x: Object arrays cannot be loaded"),
    ],
)  # fmt: skip
def test_archives_of_another_shape_are_refused_in_words(tmp_path: Path, arrays: dict, expected: str) -> None:
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(TableError, match=expected):
        read_npz(tmp_path / "a.npz", ["a"])


@settings(max_examples=50, deadline=None)
@given(
    mapping=st.recursive(
        st.none() | st.integers() | st.text(max_size=4),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
        max_leaves=10,
    )
    | st.dictionaries(
        st.text(max_size=6), st.tuples(st.integers(0, 5), st.lists(st.integers(-1, 3), max_size=3))
    ),
    rows=st.integers(1, 4),
)
def test_any_mapping_gives_columns_or_is_refused_in_words(tmp_path_factory, mapping, rows) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("npz") / "a.npz"
    np.savez(
        path, times=np.arange(rows), data=np.ones((rows, 2)), signal_mapping=np.asarray(json.dumps(mapping))
    )
    try:
        columns = read_npz(path, ["a", "data.b"])
    except LabhilError as refused:
        assert str(path) in str(refused)
        return
    assert isinstance(columns, SysidColumns)
    assert all(len(columns.numbers(place)) == rows for place in range(columns.width))


@settings(max_examples=20, deadline=None)
@given(place=st.integers(0, 10**6), bits=st.integers(1, 255))
def test_a_damaged_archive_is_read_or_refused_in_words(tmp_path_factory, place, bits) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("npz") / "a.npz"
    np.savez_compressed(path, times=np.arange(9.0), data=np.ones((9, 2)))
    data = bytearray(path.read_bytes())
    data[place % len(data)] ^= bits
    path.write_bytes(data)
    rig = parse_rig(
        '[rig]\nkind = "ball_beam"\n[channels]\nball_position = { column = "data.0" }\n'
        'servo_angle = { column = "data.1" }\n',
        Path("rig.toml"),
    )
    try:
        import_table(path, rig)
    except LabhilError as refused:
        assert str(path) in str(refused)
