"""Wrong use of the commands ends with 2 and a message, before the work and not after it."""

from __future__ import annotations

from pathlib import Path

import pytest

from labhil.cli import main

FOLDER = Path(__file__).parents[2] / "recordings"
WORDS = {"REC": str(FOLDER / "ball_beam_identify.mcap"), "EXP": str(FOLDER / "ball_beam_identify.toml")}


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
def test_it_is_told(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    message: str,
) -> None:
    (tmp_path / "rig.toml").write_text('[rig]\nkind = "ball_beam"\n')
    (tmp_path / "empty.json").write_text('{"schema": "labhil.fit/1"}\n')
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["labhil", *(WORDS.get(word, word) for word in arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    said = capsys.readouterr()
    assert (end.value.code, said.out) == (2, ""), said.err
    assert message in said.err
    assert "Traceback" not in said.err
