"""LeRobot datasets, written by pyarrow: version 2 has a file for each episode, version 3 several in one."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from labhil.command_line import app
from labhil.errors import LabhilError, TableError
from labhil.recording import describe_import, import_table, read_recording
from labhil.recording.formats.lerobot import read_parquet_or_episode
from labhil.rig import parse_rig
from labhil.rig_sections import Table

FPS = 30
LENGTHS = (40, 50, 60)
JOINTS = ["shoulder_pan.pos", "elbow_flex.pos"]


def rig(x, u, table=""):
    return parse_rig(
        f'[rig]\nkind = "ball_beam"\n[table]\n{table}\n[channels]\n'
        f'ball_position = {{ column = "{x}" }}\nservo_angle = {{ column = "{u}" }}\n',
        Path("rig.toml"),
    )


NAMED = ("observation.state.elbow_flex.pos", "action.shoulder_pan.pos")
BY_PLACE = ("observation.state_1", "action[0]")


def frames(episode, fixed=False):
    """State [e, t], action [2 t, e], as LeRobot keeps them: float32, times from 0 in each episode."""
    count = LENGTHS[episode]
    t = (np.arange(count) / FPS).astype(np.float32)
    e = np.full(count, float(episode), np.float32)
    vector = pa.list_(pa.float32(), 2) if fixed else pa.list_(pa.float32())
    return pa.table(
        {
            "observation.state": pa.array(np.column_stack([e, t]).tolist(), vector),
            "action": pa.array(np.column_stack([2 * t, e]).tolist(), vector),
            "observation.image": [{"bytes": b"x", "path": "a.png"}] * count,
            "timestamp": t,
            "frame_index": np.arange(count),
            "episode_index": np.full(count, episode),
            "next.done": np.arange(count) == count - 1,
            "task": ["push"] * count,
        }
    )


def info(path, version, names=JOINTS):
    features = {
        key: {"dtype": "float32", "shape": [2], "names": names} for key in ("observation.state", "action")
    }
    (path / "meta").mkdir(parents=True)
    described = {
        "codebase_version": version,
        "robot_type": "so100",
        "total_episodes": 3,
        "fps": FPS,
        "features": features,
    }
    (path / "meta" / "info.json").write_text(json.dumps(described))


def version_2(path, episodes=range(3)):
    info(path, "v2.1", {"motors": JOINTS})
    (path / "data/chunk-000").mkdir(parents=True)
    for episode in episodes:
        pq.write_table(frames(episode), path / f"data/chunk-000/episode_{episode:06d}.parquet")
    return path


def version_3(path, episodes=range(3), statistics=True):
    info(path, "v3.0")
    (path / "data/chunk-000").mkdir(parents=True)
    whole = pa.concat_tables([frames(episode, fixed=True) for episode in episodes])
    half = whole.num_rows // 2  # an episode may go on in the next row group, or file
    for number, part in enumerate((whole.slice(0, half), whole.slice(half))):
        file = path / f"data/chunk-000/file-{number:03d}.parquet"
        pq.write_table(part, file, row_group_size=30, write_statistics=statistics)
    return path


VERSIONS = {"2": version_2, "3": version_3, "3 bare": lambda path: version_3(path, statistics=False)}


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("names", [NAMED, BY_PLACE])
@pytest.mark.parametrize("episode", [0, 1, 2])
def test_an_episode_is_found_by_its_number_and_a_signal_by_name_or_place(tmp_path, version, names, episode):
    path = VERSIONS[version](tmp_path / "so100")
    table = import_table(path, rig(*names, f"episode = {episode}"))
    t = np.arange(LENGTHS[episode]) / FPS
    assert table.t == pytest.approx(t, abs=1e-5)
    assert table.values == pytest.approx(np.column_stack([2 * t, t]), abs=1e-5)
    lines = "\n".join(describe_import(table))
    assert f"rows are the {len(t)} frames of episode {episode} of a LeRobot dataset (robot so100, 30" in lines
    assert "not used: observation.image (images)" in lines
    assert "task (no numbers, string)" in lines


@pytest.mark.parametrize("version", VERSIONS)
def test_which_episode_is_asked_for_where_there_are_several(tmp_path, version):
    path = VERSIONS[version](tmp_path / "so100")
    with pytest.raises(TableError, match=r"--episode N, or \[table\] episode = N .*the episodes 0 to 2"):
        import_table(path, rig(*NAMED))
    with pytest.raises(TableError, match="expected an episode 7, found the episodes 0 to 2"):
        import_table(path, rig(*NAMED, "episode = 7"))
    with pytest.raises(TableError, match=r"did you mean 'observation.state.elbow_flex.pos'"):
        import_table(path, rig("observation.state.elbow_flex.po", NAMED[1], "episode = 1"))


def test_one_file_of_a_dataset_has_its_names_and_the_only_episode_needs_no_number(tmp_path):
    path = version_2(tmp_path / "so100")
    file = path / "data/chunk-000/episode_000001.parquet"
    assert len(import_table(file, rig(*NAMED))) == LENGTHS[1]
    alone = tmp_path / "alone.parquet"
    alone.write_bytes(file.read_bytes())
    assert len(import_table(alone, rig("observation.state_1", "action.0"))) == LENGTHS[1]
    assert len(import_table(version_3(tmp_path / "one", [2]), rig(*NAMED))) == LENGTHS[2]
    assert len(import_table(version_3(tmp_path / "b") / "data/chunk-000/file-001.parquet",
                            rig(*NAMED, "episode = 2"))) == LENGTHS[2]  # fmt: skip


def test_the_same_episode_has_the_same_checksum_whatever_else_is_in_the_folder(tmp_path):
    path = version_2(tmp_path / "so100")
    first = import_table(path, rig(*NAMED, "episode = 1")).sha256
    pq.write_table(frames(2).slice(5), path / "data/chunk-000/episode_000002.parquet")
    (path / "README.md").write_text("x")
    assert import_table(path, rig(*NAMED, "episode = 1")).sha256 == first
    assert import_table(path, rig(*NAMED, "episode = 2")).sha256 != first


def test_the_command_takes_the_number_of_the_episode(tmp_path):
    path, out = version_3(tmp_path / "so100"), tmp_path / "out.mcap"
    (tmp_path / "rig.toml").write_text(rig(*NAMED).text)
    command = ["import", str(path), "--rig", str(tmp_path / "rig.toml"), "-o", str(out), "--episode", "2"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    recording = read_recording(out)
    assert len(recording.stream_with("ball_position")) == LENGTHS[2]
    assert "episode 2 of a LeRobot dataset" in recording.metadata["import"]["note.0"]


def test_an_episode_of_what_is_no_dataset_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("t,ball_position,servo_angle\n0,1,2\n1,2,3\n")
    pq.write_table(pa.table({"t": [0.0, 1.0], "x": [1, 2]}), tmp_path / "a.parquet")
    for name in ("a.csv", "a.parquet"):
        with pytest.raises(TableError, match=r"expected a .*LeRobot dataset"):
            import_table(tmp_path / name, rig(*NAMED, "episode = 0"))


@pytest.mark.parametrize(
    "text", ["{", "[]", "{" * 10_000, '{"features": 3}', '{"features": {"action": []}}', "{}"]
)
def test_a_description_that_says_nothing_is_refused_or_leaves_places(tmp_path, text):
    path = version_3(tmp_path / "so100")
    (path / "meta/info.json").write_text(text)
    if text.endswith("}"):
        table = import_table(path, rig("observation.state.1", "action[0]", "episode = 1"))
        assert len(table) == LENGTHS[1]
        return
    with pytest.raises(TableError, match=r"info\.json: expected the description of a LeRobot dataset"):
        import_table(path, rig(*NAMED, "episode = 1"))


def test_a_dataset_without_data_or_with_a_file_that_is_cut_is_refused(tmp_path):
    path = version_2(tmp_path / "so100")
    file = path / "data/chunk-000/episode_000001.parquet"
    file.write_bytes(file.read_bytes()[:-30])
    with pytest.raises(TableError, match=r"episode_000001\.parquet: expected a Parquet file, found one that"):
        import_table(path, rig(*NAMED, "episode = 1"))
    for one in (path / "data/chunk-000").iterdir():
        one.unlink()
    with pytest.raises(
        TableError, match="expected Parquet files of a LeRobot dataset below data, found none"
    ):
        import_table(path, rig(*NAMED, "episode = 1"))


@settings(max_examples=40, deadline=None)
@given(
    rows=st.lists(st.none() | st.lists(st.none() | st.floats(width=32), max_size=4), min_size=1, max_size=8),
    fixed=st.booleans(),
)
def test_lists_of_any_length_are_columns_or_gaps(tmp_path_factory, rows, fixed):
    path = tmp_path_factory.mktemp("lists") / "a.parquet"
    width = max((len(row) for row in rows if row is not None), default=0)
    if fixed:
        rows = [row if row is not None and len(row) == width else None for row in rows]
    kind = pa.list_(pa.float32(), width) if fixed and width else pa.list_(pa.float32())
    count = len(rows)
    columns = {
        "action": pa.array(rows, kind),
        "timestamp": np.arange(count) / FPS,
        "frame_index": np.arange(count),
        "episode_index": np.zeros(count, dtype=np.int64),
    }
    pq.write_table(pa.table(columns), path)
    read = read_parquet_or_episode(path, Table(), ())
    for place in range(width):
        expected = [
            np.nan if row is None or len(row) < width or row[place] is None else row[place] for row in rows
        ]
        assert np.array_equal(read.numbers(read.find(f"action_{place}")[0]), expected, equal_nan=True)


@settings(max_examples=15, deadline=None)
@given(place=st.integers(0, 10**6), bits=st.integers(1, 255))
def test_a_damaged_file_is_read_or_refused_in_words(tmp_path_factory, place, bits):
    """Some damage makes the library crash: that is why it has a process of its own."""
    path = tmp_path_factory.mktemp("damaged") / "a.parquet"
    pq.write_table(frames(0), path)
    data = bytearray(path.read_bytes())
    data[place % len(data)] ^= bits
    path.write_bytes(data)
    try:
        import_table(path, rig("observation.state_1", "action[0]"))
    except LabhilError as refused:
        assert str(path) in str(refused)
