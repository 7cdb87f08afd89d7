"""The keys hold, unwrap and shift of [channels], and the faults that import and fit print."""

from __future__ import annotations

import json

import numpy as np
import pytest

from labhil.errors import RigFileError
from labhil.recording.reader import read_recording
from labhil.recording.tables import import_table
from labhil.rig import parse_rig
from labhil.signals import Hold
from labhil_benchmarks.statistics.cases import driven, levels


def table(path, **columns):
    np.savetxt(
        path, np.column_stack(list(columns.values())), "%.9g", ",", header=",".join(columns), comments=""
    )
    return path


def rig(tmp_path, text, kind="axis"):
    path = tmp_path / "rig.toml"
    lines = "\n".join(f"{name} = {{ {entry} }}" for name, entry in text.items())
    path.write_text(
        f'[rig]\nkind = "{kind}"\n[channels]\nt = {{ column = "t" }}\n{lines}\n', encoding="utf-8"
    )
    return parse_rig(path.read_text(encoding="utf-8"), path)


def test_unwrap_and_shift_are_applied_and_told(tmp_path):
    t = 0.01 * np.arange(500)
    position, force = 9.0 * np.sin(t), np.rint(3.0 * np.sin(5.0 * t))
    data = table(tmp_path / "d.csv", t=t, f=np.r_[np.zeros(2), force[:-2]], x=np.mod(position, 2 * np.pi))
    entries = {"drive_force": 'column = "f", shift = -0.02', "position": 'column = "x", unwrap = 6.283185'}
    found = import_table(data, rig(tmp_path, entries))
    assert found.values[:-2, 0] == pytest.approx(force[:-2])
    assert np.diff(found.values[:, 1]) == pytest.approx(np.diff(position), abs=1e-5)
    assert any("unwrapped" in note for note in found.notes) and any("-0.02 s" in note for note in found.notes)


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_a_stated_hold_travels_in_the_recording(labhil, tmp_path, hold):
    t = 0.01 * np.arange(300)
    data = table(tmp_path / "d.csv", t=t, f=np.sin(5.0 * t), x=np.cos(t))
    rig(tmp_path, {"drive_force": f'column = "f", hold = "{hold}"', "position": 'column = "x"'})
    done = labhil("import", data, "--rig", "rig.toml", "-o", "r.mcap")
    assert done.status == 0, done.err
    assert "as [channels] states" in done.err
    (stream,) = read_recording(tmp_path / "r.mcap").streams
    assert {s.name: s.hold for s in stream.stream.signals}["drive_force"] is Hold(hold)


@pytest.mark.parametrize(
    ("entries", "named"),
    [
        (
            {"drive_force": 'column = "f"', "position": 'column = "x", hold = "zero"'},
            "channels.position.hold",
        ),
        (
            {"drive_force": 'column = "f", hold = "cubic"', "position": 'column = "x"'},
            "channels.drive_force.hold",
        ),
        ({"drive_force": 'column = "f"', "position": 'column = "x", unwrap = 0'}, "channels.position.unwrap"),
    ],
)
def test_a_key_that_means_nothing_is_refused(tmp_path, entries, named):
    with pytest.raises(RigFileError, match=named.replace(".", r"\.")):
        rig(tmp_path, entries)


def test_import_and_fit_name_spikes_and_levels(labhil, tmp_path):
    random = np.random.default_rng(1)
    u = levels(900, 30, 5.0, random)
    channels = (("speed", "rad/s"), ("current", "A"))
    record = driven("dc_motor", u, 0.01, {}, ("viscous_friction",), 40.0, False, random, channels)[0]
    speed = record.outputs[:, 0].copy()
    speed[[101, 257, 333, 512, 700, 850]] += 40.0
    data = table(tmp_path / "d.csv", t=record.t, voltage=u, speed=speed, current=record.outputs[:, 1])
    (tmp_path / "rig.toml").write_text('[rig]\nkind = "dc_motor"\n[known]\ninertia = 0.1\n', encoding="utf-8")
    done = labhil("import", data, "--rig", "rig.toml", "-o", "r.mcap")
    assert "voltage: held between samples, it jumps between levels" in done.err
    assert "single spikes" in done.err
    done = labhil(
        "fit", "r.mcap", "--terms", "viscous_friction", "--estimator", "nlse", "--window", "0.5",
        "--json", "f.json",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert done.out.index("single spikes") < done.out.index("Parameters")
    found = json.loads((tmp_path / "f.json").read_text(encoding="utf-8"))
    assert [(fault["kind"], fault["mended"]) for fault in found["faults"]] == [("outlier", True)]
    # they are told, and take nothing from the numbers
    assert "do not rely" not in done.out and found["verdict"] == "explained"
