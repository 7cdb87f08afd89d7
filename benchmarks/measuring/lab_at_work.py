"""``labhil serve`` and ``labhil tui`` as processes, as commands that measure a lab at work start them."""

from __future__ import annotations

import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LABHIL = [sys.executable, "-P", "-m", "labhil"]


@contextmanager
def serving(folder: Path, log: str, patience: float) -> Iterator[tuple[int, str]]:
    """``labhil serve`` with the folder's ``lab.toml``: its process id and the endpoint of its bus."""
    with (folder / log).open("w", encoding="utf-8") as errors:
        command = [*LABHIL, "serve", "--config", "lab.toml"]
        service = subprocess.Popen(command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=errors)
    assert service.stdout is not None
    try:
        yield service.pid, service.stdout.readline().strip()
        service.send_signal(signal.SIGINT)
        service.wait(patience)
    finally:
        service.kill()
        service.wait()
        service.stdout.close()


def open_screen(folder: Path, endpoint: str, size: tuple[int, int]) -> tuple[subprocess.Popen[bytes], int]:
    """Start ``labhil tui`` in a terminal of so many columns and rows; the process, and the terminal."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
    process = subprocess.Popen(
        [*LABHIL, "tui", "--folder", str(folder), "--connect", endpoint],
        stdin=theirs, stdout=theirs, stderr=theirs, env=environment, start_new_session=True,
    )  # fmt: skip
    os.close(theirs)
    return process, ours
