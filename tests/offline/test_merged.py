"""A file with two runs of one stream: every command asks which, and takes the one that is chosen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labhil.analysis.dataset import load_dataset
from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch, Direction, Signal, Stream

RIG = '[rig]\nkind = "ball_beam"\n'
STREAM = Stream(
    "state",
    (Signal("servo_angle", "rad", Direction.INPUT), Signal("ball_position", "m", Direction.OUTPUT)),
    100.0,
)
COUNTS = (1600, 1900)


@pytest.fixture
def two_runs(tmp_path: Path) -> Path:
    """Two runs of 16 and 19 s, an hour apart."""
    path = tmp_path / "two.mcap"
    with RecordingWriter(path) as writer:
        writer.attach("rig.toml", "application/toml", RIG.encode())
        for number, count in enumerate(COUNTS):
            seq = np.arange(count, dtype=np.int64)
            values = np.column_stack([np.sin(seq / 17.0 + number), 0.01 * np.cos(seq / 23.0 + number)])
            channel = writer.add_stream("bench", STREAM, {"run": str(number)})
            writer.write(
                channel, Batch(seq, 10**18 + number * 36 * 10**11 + seq * 10**7, seq * 10**7, values)
            )
    return path


COMMANDS = {
    "fit": ("two.mcap",),
    "diagnose": ("two.mcap",),
    "linear": ("two.mcap",),
    "verify": ("two.mcap", "--model", "fit.json"),
    "export": ("two.mcap", "-o", "out.csv"),
    "report": ("two.mcap", "-o", "out.html"),
}
MODEL = '{"schema": "labhil.fit/1", "rig": "ball_beam", "terms": ["viscous_friction"], "parameters": []}'


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_asks_which_run(labhil, two_runs: Path, tmp_path: Path, command: str) -> None:
    (tmp_path / "fit.json").write_text(MODEL)
    told = labhil(command, *COMMANDS[command]).refused()
    assert "two.mcap: expected one run of /bench/state, found 2: 1: 1600 samples, 15.99 s from" in told
    assert "choose one with --run N" in told
    told = labhil(command, *COMMANDS[command], "--run", "3").refused()
    assert "run 3: expected a number from 1 to 2" in told


def test_the_run_that_is_chosen_is_taken(labhil, two_runs: Path, tmp_path: Path) -> None:
    for run, count in enumerate(COUNTS, 1):
        assert labhil("export", "two.mcap", "-o", "out.csv", "--run", run).status == 0
        assert len((tmp_path / "out.csv").read_text().splitlines()) == count + 1
        assert len(load_dataset(two_runs, run=run).measured) == count
        assert labhil("report", "two.mcap", "-o", f"{run}.html", "--run", run).status == 0
        assert f"{(count - 1) / 100}" in (tmp_path / f"{run}.html").read_text(encoding="utf-8")


def test_one_run_among_others_is_taken_as_it_is(two_runs: Path, labhil, tmp_path: Path) -> None:
    assert labhil("export", "two.mcap", "-o", "one.csv", "--run", "1").status == 0
    (tmp_path / "rig.toml").write_text(RIG)
    assert labhil("import", "one.csv", "--rig", "rig.toml", "-o", "one.mcap").status == 0
    dataset = load_dataset(two_runs, test_path=tmp_path / "one.mcap", run=2)
    assert len(dataset.measured) == COUNTS[1]
