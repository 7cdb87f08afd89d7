"""The end of a process by Ctrl+C where its command does not handle it."""

from __future__ import annotations

import os
from typing import NoReturn

INTERRUPTED = 130
"""Exit status after Ctrl+C where there is no result yet: 128 and the number of SIGINT, as of a shell."""


def say_interrupted() -> None:
    """Write to stderr that the process is interrupted, without anything that may not be imported yet."""
    try:
        os.write(2, b"interrupted (Ctrl+C) before there was a result\n")
    except OSError:
        return


def leave_at_once(*_signal: object) -> NoReturn:
    """End the process with a message, wherever its imports are: nothing is open yet."""
    say_interrupted()
    os._exit(INTERRUPTED)
