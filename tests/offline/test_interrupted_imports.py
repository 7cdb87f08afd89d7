"""Ctrl+C while a command is being imported: a real process, struck at moments that its imports tell."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from labhil.interrupted import INTERRUPTED

ROOT = Path(__file__).parents[2]
RECORDING = ROOT / "recordings" / "ball_beam_identify.mcap"
AT_FIRST = ("labhil.interrupted", "typer.core", "labhil.commands.analysis", "labhil.commands.tui")
IN_THE_COMMAND = ("numpy", "pydantic", "labhil.recording.reader")


@pytest.fixture(autouse=True)
def not_in_the_background() -> Iterator[None]:
    """A process that a shell has put into the background ignores Ctrl+C, and so do those that it starts."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def strike_after(module: str) -> tuple[int, str]:
    """Send SIGINT when this module has been imported; return exit status and stderr without the imports."""
    command = [sys.executable, "-P", "-X", "importtime", "-m", "labhil", "fit", str(RECORDING)]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        said, struck = [], False
        for line in process.stderr:
            if not line.startswith("import time:"):
                said.append(line)
            elif not struck and line.rpartition("|")[2].strip() == module:
                process.send_signal(signal.SIGINT)
                struck = True
        status = process.wait(60.0)
    assert struck, f"{module} was not imported"
    return status, "".join(said)


@pytest.mark.extended
@pytest.mark.parametrize("module", [*AT_FIRST[:2], AT_FIRST[3], *IN_THE_COMMAND])
def test_ctrl_c_in_an_import_ends_with_a_message(module: str) -> None:
    status, said = strike_after(module)
    assert (status, "Traceback" in said) == (INTERRUPTED, False), said
    assert said.startswith("interrupted (Ctrl+C) before there was a result")


def test_ctrl_c_as_the_commands_are_imported_ends_with_a_message() -> None:
    assert strike_after(AT_FIRST[2]) == (INTERRUPTED, "interrupted (Ctrl+C) before there was a result\n")


def test_the_entry_point_imports_nothing_before_it_can_answer() -> None:
    code = (
        "import sys; before = set(sys.modules); import labhil.cli; print(*sorted(set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], check=True, capture_output=True, text=True)
    assert set(done.stdout.split()) - {"__future__"} == {"labhil", "labhil.cli", "labhil.version"}


@pytest.mark.extended
def test_who_ignores_ctrl_c_is_not_ended_by_it() -> None:
    """A shell starts what it puts into the background so."""
    code = (
        "import signal, subprocess, sys, time\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "process = subprocess.Popen([sys.executable, '-P', '-m', 'labhil', '--version'])\n"
        "while process.poll() is None:\n"
        "    process.send_signal(signal.SIGINT)\n"
        "    time.sleep(0.01)\n"
        "sys.exit(process.returncode)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60.0
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("labhil ")
