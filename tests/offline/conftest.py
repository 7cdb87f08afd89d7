"""The command line without a bench: tables, recordings and results, each command in this process."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from labhil.cli import main

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "recordings"


@dataclass(frozen=True)
class Done:
    """How a command ended and what it said."""

    status: int
    out: str
    err: str

    def refused(self) -> str:
        """What it said on stderr, of a command that refused its input and gave no result."""
        assert (self.status, self.out) == (2, ""), self
        assert "Traceback" not in self.err
        return self.err


Labhil = Callable[..., Done]


@pytest.fixture
def labhil(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Labhil:
    """Run ``labhil …`` as the installed script does, in ``tmp_path``; an error that nobody caught fails."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Done:
        monkeypatch.setattr("sys.argv", ["labhil", *map(str, arguments)])
        capsys.readouterr()
        try:
            main()
        except SystemExit as end:
            said = capsys.readouterr()
            return Done(end.code if isinstance(end.code, int) else 0, said.out, said.err)
        said = capsys.readouterr()
        return Done(0, said.out, said.err)

    return run


@pytest.fixture(scope="session")
def shipped() -> Path:
    """Return the folder of the recordings that come with the project."""
    return SHIPPED


@pytest.fixture(scope="session")
def daisy() -> Path:
    """Return the measured table of the DaISy ball and beam; skip where it is not."""
    folder = Path(os.environ.get("LABHIL_DATA") or ROOT.parent / "shared" / "data")
    table = folder / "ball_beam_daisy" / "ballbeam.dat"
    if not table.is_file():
        pytest.skip(f"measured data are not here: {table} (set LABHIL_DATA to their folder)")
    return table
