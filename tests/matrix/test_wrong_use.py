"""Wrong use of the commands ends with 2 and a message, before the work and not after it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "recordings"
WORDS = {"REC": str(FOLDER / "ball_beam_identify.mcap"), "EXP": str(FOLDER / "ball_beam_identify.toml")}


def labhil(directory: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "labhil", *arguments]
    return subprocess.run(
        command, cwd=directory, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("fit", "REC", "--window", "-1"), "--window: expected at least 0.08 s (8 samples), found -1"),
        (("fit", "REC", "--window", "nan"), "found nan"),
        (("fit", "REC", "--model", "rig.toml"), "rig.toml: cannot be read as a model"),
        (("fit", "REC", "--model", "empty.json"), "found a result without"),
        (("fit", "REC", "--json", "nowhere/fit.json"), "nowhere/fit.json: expected a folder nowhere"),
        (("diagnose", "REC", "--plot", "nowhere/d.png"), "nowhere/d.png: expected a folder nowhere"),
        (("diagnose", "REC", "--model", "rig.toml"), "rig.toml: cannot be read as a model"),
        (("run", "EXP", "--out", "rig.toml"), "rig.toml: expected a directory for the recording"),
    ],
)
def test_it_is_told(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    (tmp_path / "rig.toml").write_text('[rig]\nkind = "ball_beam"\n')
    (tmp_path / "empty.json").write_text('{"schema": "labhil.fit/1"}\n')
    done = labhil(tmp_path, *(WORDS.get(word, word) for word in arguments))
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert message in done.stderr
    assert "Traceback" not in done.stderr
