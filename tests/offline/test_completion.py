"""The shell completes commands and options."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

LABHIL = Path(sys.executable).with_name("labhil")


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        ("labhil diag", {"diagnose"}),
        ("labhil fit --per", {"--per-recording"}),
        ("labhil trial sc", {"score"}),
    ],
)
def test_the_shell_completes(words, completed):
    asked = {"_LABHIL_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = subprocess.run([LABHIL], env={**os.environ, **asked}, capture_output=True, text=True, check=False)
    assert set(done.stdout.split()) == completed
