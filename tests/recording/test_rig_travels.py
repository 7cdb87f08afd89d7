"""A recording carries its rig file and the files that this names: nothing else is there elsewhere."""

from pathlib import Path

import numpy as np
import pytest

from labhil.analysis.rig_choice import common_rig, rig_of
from labhil.errors import RecordingError, RigFileError
from labhil.physics.mapped import charted_force
from labhil.physics.rigs import model_for
from labhil.recording import RecordingWriter, import_table, read_recording, write_import
from labhil.recording.recover import recover
from labhil.recording.rig_attachments import rig_attachments
from labhil.rig import load_rig, parse_rig
from labhil.signals import Batch, Direction, Signal, Stream

JOINT = "[[joint]]\nd = {d}\na = {a}\nalpha = {alpha}\n"
LENGTHS = (0.152, 0.0, 0.0, 0.131, 0.085, 0.092)
GRID = [(i, x) for i in (0.2, 0.5, 1.0, 1.5) for x in (0.0, 2e-3, 5e-3)]
POINTS = [(i, x, 5.0 * i + 300.0 * i * x + 7.0 * i * i) for i, x in GRID]


def links(first=0.152):
    return "".join(JOINT.format(d=d, a=-0.1 * k, alpha=0.1 * k) for k, d in enumerate((first, *LENGTHS[1:])))


def arm(folder, table="tables/links.toml", content=None):
    """A rig file in a folder of its own, with the links in another below it."""
    path = folder / "rigs" / "arm.toml"
    (path.parent / table).parent.mkdir(parents=True, exist_ok=True)
    (path.parent / table).write_text(links() if content is None else content)
    path.write_text(f'[rig]\nkind = "ur5"\n[known]\nlinks = "{table}"\n')
    return path


def plunger(folder):
    path = folder / "plunger.toml"
    rows = "".join(f"{i},{x},{force}\n" for i, x, force in POINTS)
    (folder / "map.csv").write_text(f"coil_current,plunger_position,magnetic_force\n{rows}")
    path.write_text('[rig]\nkind = "solenoid"\n[known]\nforce_map = "map.csv"\n')
    return path


def table_of(kind, path):
    names = [column for signal in (*kind.inputs, *kind.outputs) for column in signal.columns()]
    rows = np.random.default_rng(1).normal(size=(30, len(names)))
    lines = [",".join(("t", *names))]
    lines += [",".join(map(repr, (k / 100, *row))) for k, row in enumerate(rows.tolist())]
    path.write_text("\n".join(lines) + "\n")
    return path


def imported(folder, rig_path, name="log.mcap"):
    rig = load_rig(rig_path)
    return write_import(import_table(table_of(rig.kind, folder / "log.csv"), rig), folder / name)


def elsewhere(path, tmp_path_factory):
    """The recording alone, on another machine."""
    return path.replace(tmp_path_factory.mktemp("another") / path.name)


@pytest.mark.extended
def test_links_and_force_maps_travel_in_an_import_and_through_recover(tmp_path, tmp_path_factory):
    for rig_path, name in ((arm(tmp_path), "links"), (plunger(tmp_path), "force_map")):
        path = elsewhere(imported(tmp_path, rig_path), tmp_path_factory)
        saved = path.with_name("saved.mcap")
        recover(path, saved)
        for copy in (path, saved):
            rig = read_recording(copy).rig
            assert rig.known_file(name).content == load_rig(rig_path).known_file(name).content
            model_for(rig)
    model = model_for(read_recording(saved).rig)
    assert model.table is not None
    assert charted_force(1.0, 2e-3, model.table.chart) == pytest.approx(12.6)


def test_a_rig_file_that_is_given_overrides_the_one_that_travelled(tmp_path, tmp_path_factory):
    path = elsewhere(imported(tmp_path, arm(tmp_path)), tmp_path_factory)
    other = arm(tmp_path_factory.mktemp("other"), content=links(0.5))
    recording = read_recording(path)
    assert model_for(rig_of(recording, None)).links.d[0] == 0.152
    assert model_for(rig_of(recording, other)).links.d[0] == 0.5


def test_every_device_has_its_own_files(tmp_path):
    first, second = arm(tmp_path / "a"), arm(tmp_path / "b", content=links(0.5))
    stream = Stream("state", (Signal("x", "m", Direction.OUTPUT),), 1.0)
    seq = np.arange(3)
    with RecordingWriter(tmp_path / "two.mcap") as writer:
        attachments = rig_attachments(load_rig(first)) | rig_attachments(load_rig(second), "right")
        for name, content in attachments.items():
            writer.attach(name, "application/toml", content)
        for device in ("left", "right"):
            writer.write(writer.add_stream(device, stream), Batch(seq, seq, seq, np.ones((3, 1))))
    recording = read_recording(tmp_path / "two.mcap")
    found = {name: model_for(recording.of_device(name).rig).links.d[0] for name in ("left", "right")}
    assert found == {"left": 0.152, "right": 0.5}


@pytest.mark.parametrize(
    ("change", "found"),
    [(Path.unlink, "found none"), (lambda path: (path.unlink(), path.mkdir()), "found something else")],
)
def test_a_file_that_is_not_there_is_named_before_anything_is_imported(tmp_path, change, found):
    path = arm(tmp_path)
    change(path.parent / "tables" / "links.toml")
    with pytest.raises(RigFileError, match=rf"arm\.toml: known\.links: .*links\.toml, {found}"):
        load_rig(path)


def test_a_recording_that_lacks_the_file_says_what_to_do(tmp_path):
    with RecordingWriter(tmp_path / "old.mcap") as writer:
        writer.attach("rig.toml", "application/toml", arm(tmp_path).read_bytes())
    rig = read_recording(tmp_path / "old.mcap").rig
    with pytest.raises(RigFileError, match=r"known\.links: expected the file .*--rig RIG\.toml"):
        model_for(rig)
    beside = tmp_path / "tables" / "links.toml"
    beside.parent.mkdir()
    beside.write_text(links())
    assert model_for(rig).links.d[0] == 0.152


def test_recordings_are_compared_by_what_their_files_hold_not_by_where_they_stood(tmp_path):
    paths = [arm(tmp_path / "a"), arm(tmp_path / "b", "links.toml"), arm(tmp_path / "c", content=links(0.5))]
    found = [read_recording(imported(tmp_path, rig, f"{k}.mcap")) for k, rig in enumerate(paths)]
    common_rig(found[:2], None)
    with pytest.raises(RecordingError, match=r"\[known\] links = a file with SHA-256 .*give one for all"):
        common_rig([found[0], found[2]], None)


KNOWN = {
    ("solenoid", "spring_stiffness", 0.0): None,
    ("solenoid", "spring_stiffness", -1.0): "0 or a positive number",
    ("solenoid", "moving_mass", 0.0): "a positive number",
    ("solenoid", "stop_low", -1.0): None,
    ("dc_motor", "inductance", 0.0): None,
    ("dc_motor", "resistance", 0.0): "a positive number",
    ("ball_beam", "beam_length", 0.0): "a positive number",
}


@pytest.mark.parametrize("case", KNOWN)
def test_what_may_be_zero_or_negative_is_a_property_of_each_parameter(case):
    (kind, name, value), expected = case, KNOWN[case]
    text = f'[rig]\nkind = "{kind}"\n[known]\n{name} = {value}\n'
    if expected is None:
        assert parse_rig(text, Path("rig.toml")).known_number(name) == value
        return
    with pytest.raises(RigFileError, match=f"known.{name} must be {expected}, found {value}"):
        parse_rig(text, Path("rig.toml"))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("[known]\nball_mass = true\n", "ball_mass: expected a number, found true"),
        ("[nominal]\nball_mass = -1.0\n", "nominal.ball_mass must be a positive number, found -1.0"),
        ("[nominal]\nviscous_friction.coefficient = false\n", "expected a number, found false"),
    ],
)
def test_what_is_no_size_is_refused_in_nominal_too(lines, message):
    with pytest.raises(RigFileError, match=message):
        parse_rig(f'[rig]\nkind = "ball_beam"\n{lines}', Path("rig.toml"))
