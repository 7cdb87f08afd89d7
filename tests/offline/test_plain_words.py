"""Unreadable files and values of the wrong kind are answered in plain words, not in those of a library."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from experiment_text import held_voltage

import labhil as lh
from labhil.atomic_file import make_folder
from labhil.errors import (
    ExperimentFileError,
    MissingExtraError,
    ModelFileError,
    RecordingError,
    RigFileError,
    UsageError,
)
from labhil.experiment.experiment import load_experiment, parse_experiment
from labhil.experiment.plan import make_plan
from labhil.experiment.points import points_of
from labhil.recording.export import export
from labhil.rig import load_rig

RAW = re.compile(r"Errno|Expecting|codec|tuple|valid|b'|No such file or|Is a directory|parse string")
EXPERIMENT = held_voltage("levels", level=1.0)
MULTISINE = EXPERIMENT.replace('"hold"\nlevel = 1.0', '"multisine"\nfrequencies = [0.5]\namplitude = "1.5 V"')
TAGGED = EXPERIMENT.replace("[devices", 'tags = "cold"\n[devices')


@pytest.fixture
def lab(tmp_path: Path, shipped: Path) -> Path:
    """A folder with a file of each kind."""
    (tmp_path / "levels.toml").write_text(EXPERIMENT)
    (tmp_path / "motor.toml").write_text('[rig]\nkind = "dc_motor"\n')
    (tmp_path / "fit.json").write_bytes((shipped.parent / "examples" / "fit.json").read_bytes())
    (tmp_path / "settings.json").write_text("{}")
    (tmp_path / "run.mcap").write_bytes((shipped / "ball_beam_test.mcap").read_bytes()[:100])
    return tmp_path


def test_of_a_file_that_is_not_there_the_nearest_of_its_kind_is_named(
    lab: Path,
) -> None:
    for call, name, nearest, error in (
        (load_experiment, "levls.toml", "levels.toml", ExperimentFileError),
        (load_experiment, "moto.toml", "levels.toml", ExperimentFileError),
        (load_rig, "level.toml", "motor.toml", RigFileError),
        (lh.read, "runs.mcap", "run.mcap", RecordingError),
        (lh.load, "setting.json", "fit.json", ModelFileError),
    ):
        with pytest.raises(error) as caught:
            call(lab / name)
        text = str(caught.value)
        assert text.endswith(f"there is no such file; the nearest there is {nearest}"), text
        assert not RAW.search(text)
    with pytest.raises(UsageError, match=r"which is neither; the nearest there is motor\.toml"):
        lh.fit(lab / "run.mcap", lab / "moto.toml")
    named = EXPERIMENT.replace('address = "twin"', 'address = "twin"\nrig = "moto.toml"')
    with pytest.raises(ExperimentFileError, match=r"found none; the nearest there is motor\.toml"):
        make_plan(parse_experiment(named, lab / "levels.toml"))
    with pytest.raises(ExperimentFileError, match=r"there is no folder .*elsewhere$"):
        load_experiment(lab / "elsewhere" / "levels.toml")


def test_a_folder_in_place_of_a_recording_is_answered_with_what_to_give(labhil: Any, lab: Path) -> None:
    said = labhil("fit", lab).refused()
    assert f"it is a folder; give the recordings in it, like {lab}/*.mcap" in said


def test_a_file_of_another_format_is_described_without_a_literal_of_python(labhil: Any, lab: Path) -> None:
    (lab / "bench.txt").write_text("# The bench")
    for line, expected in (
        (("info", "bench.txt"), "begins with the text '# The be'"),
        (("report", "bench.txt", "-o", "a.html"), "it is no JSON: line 1, column 1 is '# The bench'"),
        (("verify", "run.mcap", "--model", "bench.txt"), "it is no JSON: line 1, column 1"),
    ):
        said = labhil(*line).refused()
        assert expected in said
        assert not RAW.search(said), said
    (lab / "empty.json").write_text("")
    with pytest.raises(ModelFileError, match="it is no JSON: it is empty"):
        lh.load(lab / "empty.json")
    (lab / "latin.json").write_bytes(b'{"name": "\xe9"}')
    with pytest.raises(ModelFileError, match=r"it is no text \(UTF-8\): byte 10 is 0xe9"):
        lh.load(lab / "latin.json")


@pytest.mark.parametrize("folder", ["/proc/x", "levels.toml", "levels.toml/inside"])
def test_a_folder_that_cannot_be_made_is_wrong_use(labhil: Any, lab: Path, folder: str) -> None:
    said = labhil("run", "levels.toml", "--out", folder).refused()
    assert f"{folder}: expected a directory for the recording, found " in said
    assert "Errno" not in said


def test_a_folder_that_nothing_can_be_written_into_is_wrong_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(**_options: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("labhil.atomic_file.TemporaryFile", refused)
    with pytest.raises(UsageError, match=r"nothing can be written there \(Permission denied\); give another"):
        make_folder(tmp_path, "the recording")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (MULTISINE, "steps.0.amplitude: expected a number or a list, found '1.5 V'"),
        (TAGGED, "experiment.tags: expected a list, found 'cold'"),
        (EXPERIMENT.replace("level = 1.0", 'level = "a"'), "steps.0.level: expected a number, found 'a'"),
    ],
)
def test_a_value_of_the_wrong_kind_is_told_once_in_plain_words(text: str, expected: str) -> None:
    with pytest.raises(ExperimentFileError) as caught:
        parse_experiment(text, Path("levels.toml"))
    assert str(caught.value) == f"levels.toml: {expected}"


def test_a_swept_value_of_the_wrong_kind_is_told_in_plain_words() -> None:
    text = f'{EXPERIMENT}\n[sweep.over]\n"steps.0.level" = ["a"]\n'
    with pytest.raises(ExperimentFileError, match=r"steps\.0\.level: expected a number, found 'a'$"):
        points_of(parse_experiment(text, Path("levels.toml")))


def test_a_wrong_name_in_python_names_no_file_that_nobody_has() -> None:
    with pytest.raises(RigFileError, match=r"^rig dc_motor: known\.resistence: .*did you mean 'resistance'"):
        lh.model("dc_motor", known={"resistence": 2})


def test_a_table_that_needs_a_package_is_named_as_it_was_given(
    shipped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = lh.read(shipped / "ball_beam_test.mcap").file
    monkeypatch.setattr("labhil.extras.is_installed", lambda module: module != "pyarrow")
    with pytest.raises(MissingExtraError, match=r"t\.parquet: writing such a file needs .*'pyarrow'"):
        export(recording, tmp_path / "t.parquet")
    assert not list(tmp_path.iterdir())
