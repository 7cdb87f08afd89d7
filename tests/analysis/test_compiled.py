"""Kernels on disk: those of other sources are compiled anew, whatever their index names."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

KERNEL = """
from typing import NamedTuple
from labhil.compiled import compiled

class {name}(NamedTuple):
    level: float

@compiled
def twice(law):
    return 2.0 * law.level

print(twice({name}(1.5)), len(twice._cache_hits))
"""


def run(folder: Path, source: str) -> str:
    (folder / "kernel.py").write_text(source, encoding="utf-8")
    command = [sys.executable, "-B", "-c", "import kernel"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()[0]


@pytest.mark.extended
def test_an_index_that_names_a_class_that_is_no_more_is_none(tmp_path: Path) -> None:
    assert run(tmp_path, KERNEL.format(name="Beyond")) == "3.0"
    assert list(tmp_path.rglob("*.nbi"))
    assert run(tmp_path, KERNEL.format(name="CompiledForce")) == "3.0"
