"""Recordings that are none of ours, hold no numbers or run backwards: each command says so, or works."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch, Direction, Signal, Stream

RIG = '[rig]\nkind = "ball_beam"\n'
COUNT = np.arange(600, dtype=np.int64)
STREAM = Stream(
    "state",
    (Signal("servo_angle", "rad", Direction.INPUT), Signal("ball_position", "m", Direction.OUTPUT)),
    100.0,
)


def foreign(path: Path, encoding: str, schema: str, payload: bytes, metadata: dict[str, str]) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema("x", schema, b"{}") if schema else 0
        channel = writer.register_channel("/x", encoding, number, metadata)
        for k in range(50):
            writer.add_message(channel, k * 10**7, payload, k * 10**7)
        writer.finish()


def stream_json(
    name: str = "x", width: object = 1, direction: str = "input", rate: object = 1
) -> dict[str, str]:
    signal = {"name": name, "unit": "m", "direction": direction, "width": width}
    return {"labhil.stream": json.dumps({"name": "state", "rate": rate, "signals": [signal]})}


FOREIGN = {
    "JSON": ("json", "jsonschema", b'{"x": 1}', {}, "channels of another program: /x (json)"),
    "JSON that is none": ("json", "jsonschema", b"\xff{", {}, "channels of another program: /x (json)"),
    "ROS": ("cdr", "ros2msg", bytes(12), {}, "channels of another program: /x (cdr)"),
    "protobuf": ("protobuf", "protobuf", b"\x01", {}, "channels of another program: /x (protobuf)"),
    "no encoding": ("", "", b"\x01", {}, "channels of another program: /x (no encoding)"),
    "no declaration": ("protobuf", "protobuf", b"\x01", {"labhil.stream": "[1]"}, "not the declaration"),
    "no JSON": ("protobuf", "protobuf", b"\x01", {"labhil.stream": "{"}, "not the declaration of a stream"),
    "a name that is none": ("protobuf", "protobuf", b"\x01", stream_json("a b"), "must be identifiers"),
    "a width below one": ("protobuf", "protobuf", b"\x01", stream_json(width=-3), "width of 1 or more"),
    "no direction": ("protobuf", "protobuf", b"\x01", stream_json(direction="up"), "not the declaration"),
    "a rate in words": ("protobuf", "protobuf", b"\x01", stream_json(rate="fast"), "not the declaration"),
    "payloads of another": (
        "protobuf",
        "protobuf",
        bytes(36),
        stream_json(),
        "expected a message of 36 bytes",
    ),
    "a speed below zero": ("protobuf", "", b"", {**stream_json(), "speed": "-1"}, "/x: "),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_recording_of_another_program_is_told(labhil, tmp_path: Path, case: str) -> None:
    encoding, schema, payload, metadata, told = FOREIGN[case]
    foreign(tmp_path / "theirs.mcap", encoding, schema, payload, metadata)
    (tmp_path / "rig.toml").write_text(RIG)
    commands = [("export", "theirs.mcap", "-o", "x.csv"), ("fit", "theirs.mcap", "--rig", "rig.toml")]
    for command in commands:
        message = labhil(*command).refused()
        assert message.startswith("theirs.mcap: ")
        assert told in message
    message = labhil("import", "theirs.mcap", "--rig", "rig.toml", "-o", "x.mcap").refused()
    assert message.startswith("theirs.mcap: ")
    assert "expected" in message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rig.toml", "theirs.mcap"]


def test_what_is_in_a_file_of_others_is_told_with_what_was_expected(labhil, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG)
    for encoding, hint in (("json", ""), ("cdr", "a ROS 2 bag becomes a recording with `labhil import`")):
        foreign(tmp_path / "theirs.mcap", encoding, "jsonschema", b"{}", {})
        for command in ("fit", "diagnose", "export", "report"):
            out = ("-o", f"x.{command}") if command in {"export", "report"} else ("--rig", "rig.toml")
            out = ("-o", "x.csv") if command == "export" else out
            told = labhil(command, "theirs.mcap", *out).refused()
            assert f"channels of another program: /x ({encoding})" in told
            assert "expected a topic /<device>/<stream>" in told
            assert hint in told
        told = labhil("import", "theirs.mcap", "--rig", "rig.toml", "-o", "x.mcap").refused()
        assert "messages" in told and "hold numbers" in told
        assert "/x" in told


def test_channels_of_others_are_named_beside_streams_of_ours(labhil, tmp_path: Path) -> None:
    both = tmp_path / "both.mcap"
    stream = Stream("state", (Signal("speed", "m/s", Direction.OUTPUT),), 100.0)
    with RecordingWriter(both) as writer:
        writer.write(writer.add_stream("bench", stream), Batch(COUNT, STEADY, STEADY, np.ones((600, 1))))
        writer._writer.register_channel("/imu", "json", 0, {})
    (tmp_path / "rig.toml").write_text(RIG)
    told = labhil("fit", both, "--rig", "rig.toml").refused()
    assert "found /bench/state: speed; of another program: /imu (json)" in told


def recorded(path: Path, values: np.ndarray, t_ns: np.ndarray) -> None:
    with RecordingWriter(path) as writer:
        writer.attach("rig.toml", "application/toml", RIG.encode())
        channel = writer.add_stream("bench", STREAM)
        writer.write(channel, Batch(COUNT, 10**18 + t_ns, t_ns, values))


def with_one(column: int, value: float) -> np.ndarray:
    values = np.column_stack([np.sin(COUNT / 17.0), np.cos(COUNT / 23.0)])
    values[100, column] = value
    return values


GOOD = with_one(0, 0.5)
STEADY = COUNT * 10**7
WRONG = {
    "one NaN": (with_one(1, np.nan), STEADY, "ball_position: expected finite numbers, found 1 of 600"),
    "infinity": (with_one(0, np.inf), STEADY, "servo_angle: expected finite numbers, found 1 of 600"),
    "NaN all the way": (np.full((600, 2), np.nan), STEADY, "found 600 of 600 samples that are none"),
    "backwards": (GOOD, STEADY[::-1].copy(), "expected times that increase, found 599 that do not"),
    "one time for all": (GOOD, 0 * STEADY, "expected times that increase"),
    "times in pairs": (GOOD, STEADY // (2 * 10**7) * (2 * 10**7), "found 300 that do not"),
    "a clock that was set back": (GOOD, np.where(COUNT > 300, STEADY - 10**9, STEADY), "found 1 that do not"),
}


@pytest.mark.parametrize("case", WRONG)
def test_numbers_that_are_none_and_times_that_stand_are_not_fitted(labhil, tmp_path: Path, case: str) -> None:
    values, t_ns, told = WRONG[case]
    recorded(tmp_path / "wrong.mcap", values, t_ns)
    message = labhil("fit", "wrong.mcap", "--holdout", "0").refused()
    assert message.splitlines()[-1].startswith("wrong.mcap: ")
    assert told in message
    assert labhil("export", "wrong.mcap", "-o", "x.csv").status == 0
    assert labhil("recover", "wrong.mcap", "-o", "again.mcap").status == 0


def test_what_a_fit_refuses_is_good_once_it_went_through_a_table(labhil, tmp_path: Path) -> None:
    recorded(tmp_path / "wrong.mcap", with_one(1, np.nan), STEADY)
    (tmp_path / "rig.toml").write_text(RIG)
    assert labhil("export", "wrong.mcap", "-o", "x.csv").status == 0
    done = labhil("import", "x.csv", "--rig", "rig.toml", "-o", "good.mcap")
    assert done.status == 0
    assert "599 of 600 rows" in done.err


KINDS = {
    "rig.toml": RIG.encode(),
    "table.csv": b"t,servo_angle,ball_position\n0,1,2\n1,2,3\n",
    "fit.json": b'{"schema": "labhil.fit/1"}',
    "page.html": b"<!doctype html>",
    "noise.bin": bytes(range(256)) * 9,
    "folder": None,
}


@pytest.mark.parametrize("file", KINDS)
def test_files_of_the_wrong_kind_are_named(labhil, tmp_path: Path, file: str) -> None:
    for name, content in KINDS.items():
        if content is None:
            (tmp_path / name).mkdir()
        else:
            (tmp_path / name).write_bytes(content)
    commands = [
        ("export", file, "-o", "x.csv"),
        ("recover", file, "-o", "x.mcap"),
        ("diagnose", file),
        ("verify", file, "--model", "fit.json"),
        ("import", "table.csv", "--rig", file, "-o", "x.mcap"),
        ("run", file, "--dry-run"),
    ]
    before = sorted(tmp_path.iterdir())
    for command in commands:
        if command[0] == "import" and file == "rig.toml":
            continue
        message = labhil(*command).refused()
        assert file in message or "fit.json" in message, (command, message)
        assert (
            "expected" in message
            or "cannot be read" in message
            or "not TOML" in message
            or "missing" in message
        )
    assert sorted(tmp_path.iterdir()) == before


def test_places_that_cannot_be_written_are_named(labhil, tmp_path: Path, shipped: Path) -> None:
    recording = shipped / "ball_beam_test.mcap"
    (tmp_path / "file").write_text("")
    (tmp_path / "table.csv").write_bytes(KINDS["table.csv"])
    (tmp_path / "rig.toml").write_text(RIG)
    closed = tmp_path / "closed"
    closed.mkdir()
    closed.chmod(0o555)
    places = ["file", *([] if os.geteuid() == 0 else ["closed"])]
    for place in places:
        for command in (
            ("export", recording, "-o", f"{place}/x.csv"),
            ("recover", recording, "-o", f"{place}/x.mcap"),
            ("import", "table.csv", "--rig", "rig.toml", "-o", f"{place}/x.mcap"),
            ("report", recording, "-o", f"{place}/x.html"),
        ):
            done = labhil(*command)
            assert done.status in (1, 2), command
            assert done.out == ""
            assert f"{place}" in done.err
            assert "Traceback" not in done.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["closed", "file", "rig.toml", "table.csv"]
