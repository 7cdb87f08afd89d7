"""Results that were moved together with their recordings: these are found beside them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

import labhil as lh
from labhil.analysis.find_recording import find_recording
from labhil.analysis.patch_source import read_patch_source
from labhil.campaign.studies.overlay import recording_of
from labhil.errors import ModelFileError


@pytest.fixture
def moved(tmp_path: Path, shipped: Path) -> Path:
    """A folder with two copies of a fit and its recordings, which the fit names elsewhere."""
    folder = tmp_path / "moved"
    folder.mkdir()
    for name in ("ball_beam_identify.mcap", "ball_beam_test.mcap"):
        shutil.copy(shipped / name, folder)
    for name in ("one.json", "two.json"):
        shutil.copy(shipped.parent / "examples" / "fit.json", folder / name)
    return folder


def test_results_are_compared_from_another_folder(labhil: Any, moved: Path) -> None:
    done = labhil("compare", moved / "one.json", moved / "two.json", "--horizon", "1", "--json", "c.json")
    assert done.status == 0, done.err
    (source,) = lh.load("c.json").recordings
    assert source.path == str(moved / "ball_beam_test.mcap")


def test_a_recording_that_is_nowhere_is_told(labhil: Any, moved: Path) -> None:
    (moved / "ball_beam_test.mcap").unlink()
    said = labhil("compare", moved / "one.json", moved / "two.json").refused()
    assert f"found none there nor beside {moved / 'one.json'}; --recording names where it is now" in said


def test_a_patch_and_the_screen_find_them_at_the_same_place(
    moved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    source = read_patch_source(moved / "one.json")
    assert source.test == (moved / "ball_beam_test.mcap",)
    stated = "recordings/ball_beam_test.mcap"
    assert recording_of(moved / "one.json", stated) == moved / "ball_beam_test.mcap"
    with pytest.raises(ModelFileError, match="found none there nor beside it"):
        recording_of(moved / "one.json", "recordings/none.mcap")


def test_of_files_of_one_name_that_with_the_stated_content_is_taken(tmp_path: Path, shipped: Path) -> None:
    other, beside = tmp_path / "other" / "run.mcap", tmp_path / "run.mcap"
    other.parent.mkdir()
    other.write_bytes(b"another run")
    shutil.copy(shipped / "ball_beam_test.mcap", beside)
    sha256 = lh.read(beside).file.sha256
    assert find_recording(tmp_path / "fit.json", other, sha256) == beside
    assert find_recording(tmp_path / "fit.json", other) == other
    assert find_recording(tmp_path / "fit.json", tmp_path / "none.mcap") is None
