"""Bad input offline: status 2, what was expected and what was found, no traceback, no half a result."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch, Direction, Signal, Stream

GOOD_RIG = '[rig]\nkind = "ball_beam"\n'
HEADER = "t,servo_angle,ball_position\n"
ROWS = "".join(f"{k / 100},{0.1 * np.sin(k / 9):.6f},{0.01 * np.cos(k / 9):.6f}\n" for k in range(300))

WRONG_RIGS = {
    "no table [rig]": ("[known]\nball_mass = 0.26\n", "the table [rig]", "is missing"),
    "no kind": ('[rig]\n[known]\nball_mass = 0.26\n', "rig.kind", "this key is missing"),
    "no such kind": ('[rig]\nkind = "ball_bean"\n', "rig.kind", "did you mean 'ball_beam'"),
    "misspelt table": (GOOD_RIG + "[knwon]\nball_mass = 0.26\n", "knwon: unknown key", "'known'"),
    "misspelt parameter": (
        GOOD_RIG + "[known]\nbal_mass = 0.26\n", "known.bal_mass", "did you mean 'ball_mass'",
    ),
    "misspelt channel": (
        GOOD_RIG + "[channels]\nball_postion = { column = 1 }\n", "channels.ball_postion", "'ball_position'",
    ),
    "misspelt key of [table]": (
        GOOD_RIG + '[table]\ndelimeter = "tab"\n', "table.delimeter: unknown key", "'delimiter'",
    ),
    "no such delimiter": (GOOD_RIG + '[table]\ndelimiter = "pipe"\n', "table.delimiter", "found 'pipe'"),
    "text for a number": (GOOD_RIG + "[table]\nrate = \"fast\"\n", "table.rate", "found 'fast'"),
    "negative mass": (GOOD_RIG + "[known]\nball_mass = -1.0\n", "ball_mass", "must be a positive number"),
    "text for a mass": (GOOD_RIG + '[known]\nball_mass = "heavy"\n', "known.ball_mass", "found 'heavy'"),
    "two masses": (GOOD_RIG + "[known]\nball_mass = [1.0, 2.0]\n", "known.ball_mass", "found [1.0, 2.0]"),
    "nominal that is none": (
        GOOD_RIG + "[nominal]\nviscous_friction.coefficient = nan\n", "nominal.viscous_friction", "found nan",
    ),
    "endless horizon": (GOOD_RIG + "[metric]\nhorizon = inf\n", "metric.horizon", "found inf"),
    "limits upside down": (
        GOOD_RIG + "[limits]\nball_position = { min = 1.0, max = -1.0 }\n", "limits.ball_position", "smaller",
    ),
    "no TOML": ("kind: ball_beam\n", "not TOML", "rig.toml"),
    "empty": ("", "the table [rig]", "is missing"),
}  # fmt: skip

WRONG_TABLES = {
    "missing column": ("t,servo_angle,position\n" + ROWS, ("ball_position", "servo_angle")),
    "only a header": (HEADER, ("found", "rows")),
    "empty": ("", ("empty",)),
    "prose": ("Dear colleague,\nplease find enclosed\nthe data.\n", ("column",)),
    "text all the way": (HEADER + "0.0,a,b\n" * 40, ("row",)),
    "NaN all the way": (HEADER + "".join(f"{k},nan,0.1\n" for k in range(40)), ("row",)),
    "not a text": (b"\x00\xff\xfe\x80" * 64, ("table",)),
}

GOES_ON = {
    "text in a cell": "0.505,oops,0.01\n",
    "NaN in a cell": "0.505,nan,0.01\n",
    "infinity in a cell": "0.505,0.1,inf\n",
    "a cell too few": "0.505,0.1\n",
}


@pytest.mark.parametrize("case", WRONG_RIGS)
def test_a_wrong_rig_file_is_refused_by_field(labhil, tmp_path: Path, case: str) -> None:
    text, *told = WRONG_RIGS[case]
    (tmp_path / "rig.toml").write_text(text)
    (tmp_path / "bench.csv").write_text(HEADER + ROWS)
    message = labhil("import", "bench.csv", "--rig", "rig.toml", "-o", "bench.mcap").refused()
    assert "rig.toml" in message
    for word in told:
        assert word in message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bench.csv", "rig.toml"]


@pytest.mark.parametrize("case", WRONG_TABLES)
def test_a_wrong_table_is_refused_and_leaves_no_recording(labhil, tmp_path: Path, case: str) -> None:
    content, told = WRONG_TABLES[case]
    (tmp_path / "rig.toml").write_text(GOOD_RIG)
    (tmp_path / "bench.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    message = labhil("import", "bench.csv", "--rig", "rig.toml", "-o", "bench.mcap").refused()
    assert "bench.csv" in message
    for word in told:
        assert word in message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bench.csv", "rig.toml"]


@pytest.mark.parametrize("case", GOES_ON)
def test_a_bad_row_is_dropped_and_told_or_refused_with_its_line(labhil, tmp_path: Path, case: str) -> None:
    lines = ROWS.splitlines(keepends=True)
    (tmp_path / "bench.csv").write_text(HEADER + "".join([*lines[:51], GOES_ON[case], *lines[51:]]))
    (tmp_path / "drop.toml").write_text(GOOD_RIG)
    (tmp_path / "fail.toml").write_text(GOOD_RIG + '[table]\nbad_rows = "fail"\n')
    done = labhil("import", "bench.csv", "--rig", "drop.toml", "-o", "bench.mcap")
    assert done.status == 0
    assert "300 of 301 rows" in done.err
    message = labhil("import", "bench.csv", "--rig", "fail.toml", "-o", "strict.mcap").refused()
    assert "53" in message, "the line of the bad row, the header being line 1"
    assert not (tmp_path / "strict.mcap").exists()


NO_RECORDINGS = {
    "empty": b"",
    "text": HEADER.encode() + ROWS.encode(),
    "magic alone": b"\x89MCAP0\r\n",
    "magic and garbage": b"\x89MCAP0\r\n" + bytes(range(256)) * 8,
}


@pytest.mark.parametrize("command", [("fit",), ("diagnose",), ("export", "-o", "x.csv")])
@pytest.mark.parametrize("case", NO_RECORDINGS)
def test_what_is_no_recording_is_refused(labhil, tmp_path: Path, command, case: str) -> None:
    (tmp_path / "run.mcap").write_bytes(NO_RECORDINGS[case])
    name, *rest = command
    message = labhil(name, "run.mcap", *rest).refused()
    assert "run.mcap" in message
    assert "expected" in message or "the file ends after 8 bytes" in message
    assert not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("fit", "REC", "--terms", "viscous_frictoin"), ("did you mean 'viscous_friction'", "dead_zone")),
        (("fit", "REC", "--estimator", "magic"), ("estimator 'magic'", "nlse")),
        (("fit", "REC", "--holdout", "1.5"), ("--holdout", "0.05", "1.5")),
        (("fit", "REC", "--holdout", "many"), ("--holdout", "valid number")),
        (("fit", "REC", "--rig", "nowhere.toml"), ("nowhere.toml",)),
        (("fit", "REC", "--test", "nowhere.mcap"), ("nowhere.mcap",)),
        (("fit", "nowhere.mcap"), ("nowhere.mcap",)),
        (("fit", "."), (".: cannot be read",)),
        (("diagnose", "REC", "--baseline", "friction"), ("friction", "viscous_friction")),
        (("diagnose", "REC", "--model", "other.json"), ("other.json", "labhil.fit/1", "someone/9")),
        (("diagnose", "REC", "--model", "cut.json"), ("cut.json",)),
        (("diagnose", "REC", "--rig", "nominal.toml"), ("nominal.toml", "viscous_friction.coefficient")),
        (("export", "REC", "-o", "table.xyz"), (".xyz", ".csv")),
        (("terms", "ball_bean"), ("did you mean 'ball_beam'",)),
    ],
)
def test_wrong_use_is_told_before_any_work(labhil, tmp_path: Path, shipped: Path, arguments, told) -> None:
    (tmp_path / "other.json").write_text('{"schema": "someone/9", "terms": [], "parameters": []}')
    (tmp_path / "cut.json").write_text('{"schema": "labhil.fit/1", "terms": ["visc')
    (tmp_path / "nominal.toml").write_text(GOOD_RIG + "[nominal]\nviscous_friction.coeficient = 0.1\n")
    recording = shipped / "ball_beam_identify.mcap"
    message = labhil(*(recording if word == "REC" else word for word in arguments)).refused()
    for word in told:
        assert word in message


def recorded(path: Path, names: tuple[str, ...], rows: int, rig: str | None) -> None:
    """Write a recording of so many rows at 100 Hz; without ``rig`` it carries no rig file."""
    signals = tuple(Signal(name, "rad", Direction.INPUT) for name in names)
    seq = np.arange(rows, dtype=np.int64)
    values = np.column_stack([np.sin(seq / (7.0 + i)) for i in range(len(names))])
    with RecordingWriter(path) as writer:
        if rig is not None:
            writer.attach("rig.toml", "application/toml", rig.encode())
        channel = writer.add_stream("bench", Stream("state", signals, 100.0))
        writer.write(channel, Batch(seq, 10**18 + seq * 10**7, seq * 10**7, values))


SIGNALS = ("servo_angle", "ball_position")


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_a_recording_without_a_rig_file_asks_for_one(labhil, tmp_path: Path, command: str) -> None:
    recorded(tmp_path / "bare.mcap", SIGNALS, 400, None)
    assert "carries no rig file; give one with --rig" in labhil(command, "bare.mcap").refused()


@pytest.mark.parametrize("command", ["fit", "diagnose"])
@pytest.mark.parametrize("names", [("servo_angle",), ("ball_position",), ("voltage", "speed")])
def test_a_recording_without_the_rigs_signals_is_told_what_it_has(
    labhil, tmp_path: Path, command: str, names: tuple[str, ...]
) -> None:
    recorded(tmp_path / "other.mcap", names, 400, GOOD_RIG)
    message = labhil(command, "other.mcap").refused()
    assert "needs ball_position and servo_angle or beam_angle" in message
    assert f"found /bench/state: {', '.join(names)}" in message


@pytest.mark.parametrize("command", ["fit", "diagnose"])
@pytest.mark.parametrize("rows", [0, 1, 2, 5, 30, 300])
def test_a_recording_that_is_too_short_is_told_how_short(
    labhil, tmp_path: Path, command: str, rows: int
) -> None:
    recorded(tmp_path / "short.mcap", SIGNALS, rows, GOOD_RIG)
    message = labhil(command, "short.mcap").refused()
    assert "short.mcap" in message
    assert any(character.isdigit() for character in message)


def test_the_two_recordings_must_have_the_same_input(labhil, tmp_path: Path) -> None:
    recorded(tmp_path / "one.mcap", SIGNALS, 3000, GOOD_RIG)
    recorded(tmp_path / "two.mcap", ("beam_angle", "ball_position"), 3000, GOOD_RIG)
    message = labhil("fit", "one.mcap", "--test", "two.mcap").refused()
    assert "expected the input servo_angle" in message
    assert "found beam_angle" in message


def samples(path: Path) -> list[str]:
    """The lines of an exported table without their time, which is regressed on all samples that are there."""
    return [line.partition(",")[2] for line in path.read_text().splitlines()]


def test_a_recording_cut_anywhere_is_exported_up_to_there_or_refused(
    labhil, tmp_path: Path, shipped: Path
) -> None:
    whole = (shipped / "ball_beam_test.mcap").read_bytes()
    (tmp_path / "whole.mcap").write_bytes(whole)
    assert labhil("export", "whole.mcap", "-o", "whole.csv").status == 0
    lines = samples(tmp_path / "whole.csv")
    random, kept = np.random.default_rng(4), []
    for length in [*random.integers(1, len(whole), 12).tolist(), len(whole) - 1]:
        (tmp_path / "cut.mcap").write_bytes(whole[:length])
        done = labhil("export", "cut.mcap", "-o", "cut.csv")
        if done.status == 0:
            assert "cut.mcap: read as far as it goes" in done.err
            part = samples(tmp_path / "cut.csv")
            assert len(part) > 1
            assert part == lines[: len(part)]
            kept.append(length)
        else:
            assert "cut.mcap" in done.refused()
    assert len(kept) > 6, "most cuts leave whole chunks"


@pytest.mark.extended
def test_a_cut_recording_is_fitted_as_far_as_it_goes(labhil, tmp_path: Path, shipped: Path) -> None:
    whole = (shipped / "ball_beam_identify.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: 7 * len(whole) // 10])
    done = labhil("fit", "cut.mcap", "--terms", "viscous_friction", "--window", "1", "--json", "fit.json")
    assert done.status == 0, done.err
    assert "cut.mcap: read as far as it goes" in done.err
    (source,) = json.loads((tmp_path / "fit.json").read_text())["recordings"]
    assert 1000 < source["samples"] < 2800


WRONG_MODELS = {
    "no name": '"terms": ["viscous_friction"], "parameters": [{"value": 1.0}]',
    "text for a value": '"terms": ["viscous_friction"], "parameters": [{"name": "x", "value": "much"}]',
    "NaN for a value": '"terms": ["viscous_friction"], "parameters": [{"name": "x", "value": NaN}]',
    "no rows": '"terms": ["viscous_friction"], "parameters": ["viscous_friction.coefficient"]',
    "terms that are none": '"terms": [["viscous_friction"]], "parameters": []',
    "an unknown term": '"terms": ["viscous_frictoin"], "parameters": []',
}


@pytest.mark.parametrize("command", ["fit", "diagnose"])
@pytest.mark.parametrize("case", WRONG_MODELS)
def test_a_file_that_is_no_model_is_refused(
    labhil, tmp_path: Path, shipped: Path, command: str, case: str
) -> None:
    (tmp_path / "fit.json").write_text(f'{{"schema": "labhil.fit/1", {WRONG_MODELS[case]}}}')
    recording = shipped / "ball_beam_identify.mcap"
    message = labhil(command, recording, "--model", "fit.json").refused()
    assert "viscous_frictoin" in message or ("fit.json" in message and "expected" in message)
