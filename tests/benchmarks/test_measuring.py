"""The commands that measure: each still fits the program."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
COMMANDS = sorted(BENCHMARKS.glob("measuring/measure_*.py"))


@pytest.mark.extended
@pytest.mark.parametrize("command", COMMANDS, ids=lambda path: path.stem)
def test_a_measuring_command_says_what_it_takes(command: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(BENCHMARKS)}
    done = subprocess.run(
        [sys.executable, str(command), "--help"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    assert "usage:" in done.stdout


def test_what_the_ablation_takes_out_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(BENCHMARKS / "measuring")
    variants = importlib.import_module("measure_ablation").VARIANTS
    taken_out = [(owner, name) for _, parts in variants.values() for owner, name, _ in parts]
    assert len(taken_out) > 5
    assert all(name in vars(owner) for owner, name in taken_out)


def test_there_are_some() -> None:
    assert len(COMMANDS) > 15
