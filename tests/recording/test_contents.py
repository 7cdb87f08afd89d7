"""What ``labhil info`` and ``labhil list`` say of recordings, finished, cut short and foreign."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labhil.errors import RecordingError
from labhil.recording.contents import status_from_metadata
from labhil.recording.listing import list_folder
from labhil.recording.metadata import read_metadata
from labhil.recording.reader import read_recording
from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch, Direction, Signal, Stream

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "recordings" / "ball_beam_test.mcap"
START_NS = 1_780_000_000_000_000_000
STREAM = Stream(
    "state",
    (Signal("voltage", "V", Direction.INPUT), Signal("speed", "rad/s", Direction.OUTPUT)),
    100.0,
)


def labhil(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "labhil", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    return done


def write(path: Path, *, tags: list[str], marker: str, start_ns: int = START_NS) -> Path:
    """Write 200 samples at 100 Hz of which three in a row are lost, with a marker after one second."""
    kept = np.r_[0:100, 103:203]
    with RecordingWriter(path) as writer:
        channel = writer.add_stream("bench", STREAM)
        t_ns = start_ns + kept * 10_000_000
        values = np.column_stack([np.full(200, 2.0), np.linspace(0.0, 5.0, 200)])
        writer.write(channel, Batch(kept, t_ns, t_ns, values))
        told = {"name": "levels", "operator": "Ada", "notes": "after \x1b[31mlunch", "tags": json.dumps(tags)}
        writer.metadata("experiment", told)
        writer.event("run", start_ns + 1_000_000_000, {"t_ns": start_ns, "kind": "mark", "message": marker})
        return writer.finish("0", "all steps are done")


def info(path: Path) -> dict[str, Any]:
    done = labhil("info", path, "--json")
    assert done.returncode == 0, done.stderr
    data: dict[str, Any] = json.loads(done.stdout)
    return data


@pytest.mark.extended
def test_info_counts_rates_gaps_and_names_what_fits(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", tags=["cold"], marker="oil added")
    found = info(path)
    assert (found["schema"], found["status"], found["fits"]) == ("labhil.info/1", "done", ["dc_motor"])
    assert (found["operator"], found["tags"], found["rig"]) == ("Ada", ["cold"], None)
    (stream,) = found["streams"]
    assert (stream["samples"], stream["lost"], stream["longest_gap"]) == (200, 3, 3)
    assert stream["rate"] == pytest.approx(100.0)
    assert [(signal["name"], signal["lowest"], signal["highest"]) for signal in stream["signals"]] == [
        ("voltage", 2.0, 2.0),
        ("speed", 0.0, 5.0),
    ]
    assert [(event["kind"], event["message"]) for event in found["events"]] == [("mark", "oil added")]
    assert found["events"][0]["t"] == pytest.approx(1.0, abs=1e-6)
    text = labhil("info", path).stdout
    assert "200 samples, 3 lost (up to 3 in a row), 100 Hz" in text
    assert "\x1b" not in text


def test_info_of_a_shipped_recording_agrees_with_its_reader() -> None:
    found, recording = info(SHIPPED), read_recording(SHIPPED)
    assert found["rig"] == "ball_beam"
    assert "ball_beam" in found["fits"]
    assert found["sha256"] == recording.sha256
    assert found["duration"] == recording.duration
    assert sum(stream["samples"] for stream in found["streams"]) == sum(map(len, recording.streams))


def test_info_of_a_recording_without_an_end_says_so(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(SHIPPED.read_bytes()[:-200])
    found = info(cut)
    assert (found["status"], found["complete"]) == ("no end", False)
    assert "without the end" in found["damage"]


def names(*arguments: object) -> list[str]:
    done = labhil("list", *arguments, "--json")
    assert done.returncode == 0, done.stderr
    return [Path(entry["path"]).name for entry in json.loads(done.stdout)["files"]]


def test_metadata_are_read_from_the_end_whatever_the_samples_are(tmp_path: Path) -> None:
    whole = read_recording(SHIPPED)
    path = tmp_path / "long.mcap"
    data = bytearray(SHIPPED.read_bytes())
    assert read_metadata(SHIPPED) == {name: dict(table) for name, table in whole.metadata.items()}
    tenth = len(data) // 10
    data[4 * tenth : 6 * tenth] = bytes(2 * tenth)
    path.write_bytes(data)
    assert not read_recording(path).complete
    assert read_metadata(path) == read_metadata(SHIPPED)
    assert status_from_metadata(read_metadata(path)) == "done"


def test_metadata_that_are_not_where_the_index_says_are_refused(tmp_path: Path) -> None:
    data = bytearray(SHIPPED.read_bytes())
    data[1000 : len(data) // 2] = bytes(len(data) // 2 - 1000)
    path = tmp_path / "hollow.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="found no index of its metadata"):
        read_metadata(path)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_a_file_without_an_end_has_no_metadata_to_rely_on(tmp_path: Path, share: float) -> None:
    data = SHIPPED.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(RecordingError, match=r"cut.mcap: expected a finished recording"):
        read_metadata(path)


def test_list_shows_a_verification_with_its_verdict(tmp_path: Path) -> None:
    told = {
        "schema": "labhil.verification/1",
        "recordings": [{"path": "run.mcap", "rig": "dc_motor"}],
        "model": "fit.json",
        "rig": "dc_motor",
        "verdict": "contradicted",
    }
    (tmp_path / "run.verification.json").write_text(json.dumps(told))
    (entry,) = list_folder([tmp_path])
    assert (entry.kind, entry.status, entry.rig) == ("verification", "contradicted", "dc_motor")
    assert entry.summary == "run.mcap"


@pytest.mark.extended
def test_list_finds_by_tag_rig_time_and_text(tmp_path: Path) -> None:
    day = 86_400_000_000_000
    write(tmp_path / "a.mcap", tags=["cold"], marker="oil added")
    (tmp_path / "below").mkdir()
    write(tmp_path / "below" / "b.mcap", tags=["cold", "worn"], marker="noise", start_ns=START_NS + 3 * day)
    shutil.copy(SHIPPED, tmp_path / "c.mcap")
    (tmp_path / "fit.json").write_text(
        json.dumps({"schema": "labhil.fit/1", "rig": "dc_motor", "verdict": "explained", "recordings": []})
    )
    (tmp_path / "other.json").write_text("[1, 2]")
    (tmp_path / "broken.mcap").write_bytes(b"no recording")
    assert sorted(names(tmp_path)) == ["a.mcap", "b.mcap", "broken.mcap", "c.mcap", "fit.json"]
    assert names(tmp_path, "--tag", "cold") == ["b.mcap", "a.mcap"]
    assert names(tmp_path, "--tag", "COLD", "--tag", "worn") == ["b.mcap"]
    assert names(tmp_path, "--rig", "ball_beam") == ["c.mcap"]
    assert names(tmp_path, "--rig", "dc_motor") == ["fit.json"]
    assert names(tmp_path, "--text", "OIL") == ["a.mcap"]
    assert "a.mcap" not in names(tmp_path, "--since", "2026-05-30", "--text", "lunch")
    assert names(tmp_path, "--until", "2026-05-30", "--text", "lunch") == ["a.mcap"]
    shown = labhil("list", tmp_path).stdout
    assert "unreadable" in shown
    assert "#cold #worn levels, Ada" in shown
    assert "\x1b" not in shown


@pytest.mark.extended
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--since", "yesterday"), "--since 'yesterday': expected a date like 2026-05-31"),
        (("--rig", "ball_bean"), "did you mean 'ball_beam'"),
        (("nowhere",), "nowhere: expected a folder"),
    ],
)
def test_a_wrong_question_is_answered_with_what_was_expected(
    arguments: tuple[str, ...], message: str
) -> None:
    done = labhil("list", *arguments)
    assert done.returncode == 2
    assert message in done.stderr


@pytest.mark.parametrize(
    ("made_by", "status"), [({"experiment": {}}, "done"), ({"lab": {}}, "done"), ({}, "imported")]
)
def test_a_recording_of_a_lab_in_service_is_not_imported(made_by: dict[str, Any], status: str) -> None:
    assert status_from_metadata({"end": {"exit_status": "0"}, **made_by}) == status
