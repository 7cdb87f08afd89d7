"""What all commands share: results to stdout or a file, everything else to stderr."""

from __future__ import annotations

import errno
import io
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from labhil.atomic_file import write_json_file
from labhil.errors import UsageError
from labhil.extras import require
from labhil.terminal import complain, printable_json, show, terminal

STDOUT = Path("-")
"""Stands for stdout in place of the path of a result."""
DRAWN = (".png", ".pdf", ".svg", ".html", ".htm")
"""Endings of results that are drawn."""


class _Outlet(io.RawIOBase):
    """A descriptor that is written to as long as somebody takes it; ``failure`` is why it takes no more.

    A reader that has seen enough (``| head -1``) is no failure.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._closed_by_reader = False
        self.failure: OSError | None = None

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def write(self, data: Any) -> int:
        if self._closed_by_reader or self.failure is not None:
            return len(data)
        try:
            return os.write(self._descriptor, data)
        except BrokenPipeError:
            self._closed_by_reader = True
        except OSError as error:
            if error.errno == errno.EAGAIN:
                raise
            self.failure = error
        return len(data)


@contextmanager
def forgiving_streams() -> Iterator[None]:
    """Let no result be lost to stdout: a closed pipe is no failure, what it cannot encode becomes "?".

    Any other failure of stdout (a full disk) is reported at the end, with exit status 1.
    """
    before = sys.stdout, sys.stderr
    outlets: list[_Outlet] = []
    sys.stdout, sys.stderr = (_make_forgiving(stream, outlets) for stream in before)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        failure = next((outlet.failure for outlet in outlets if outlet.fileno() == 1), None)
        if failure is not None:
            with suppress(OSError):
                complain(f"stdout could not be written: {failure.strerror}")
            sys.exit(1)


def _make_forgiving(stream: TextIO, outlets: list[_Outlet]) -> TextIO:
    """The same stream over an outlet; anything but a descriptor of this process stays as it is."""
    if not isinstance(stream, io.TextIOWrapper) or stream not in (sys.__stdout__, sys.__stderr__):
        return stream
    with suppress(OSError, ValueError):
        stream.flush()
    outlets.append(_Outlet(stream.fileno()))
    errors = "replace" if stream is sys.__stdout__ else "backslashreplace"
    return io.TextIOWrapper(
        io.BufferedWriter(outlets[-1]),
        encoding=stream.encoding,
        errors=errors,
        line_buffering=stream.line_buffering or stream is sys.__stderr__,
        write_through=stream.write_through,
    )


def deliver(data: dict[str, Any], path: Path | None, display: Callable[[], object]) -> None:
    """Save a result, then show it: what fails while it is shown cannot lose it.

    With the path ``-`` it goes to stdout as JSON, and nothing else does.
    """
    if path is not None:
        write_json(data, path)
    if path != STDOUT:
        display()


def write_json(data: dict[str, Any], path: Path | None = None) -> None:
    """Write a result as JSON, to stdout or a file; numbers that are not finite have been made None before."""
    if path is None or path == STDOUT:
        # a terminal that knows fewer characters gets them as JSON writes them in ASCII
        ascii_only = "utf" not in (getattr(sys.stdout, "encoding", None) or "utf-8").lower()
        show(printable_json(json.dumps(data, ensure_ascii=ascii_only, allow_nan=False, indent=1)))
        return
    write_json_file(data, path)


def refuse_unwritable(*paths: Path | None) -> None:
    """Raise UsageError for a result's path that cannot be a file there, before the work and not after it.

    MissingExtraError for a picture, or a page with pictures, where what draws them is not installed.
    """
    for path in paths:
        if path is None or path == STDOUT:
            continue
        if path.suffix.lower() in DRAWN:
            require("matplotlib", f"{path}: drawing")
        if path.is_dir():
            raise UsageError(f"{path}: expected a file to write, found a folder")
        if not path.parent.is_dir():
            raise UsageError(f"{path}: expected a folder {path.parent} to write into, found none")


def tell(lines: Iterable[str]) -> None:
    """Print what a person should know beside the result."""
    complain(*lines)


def split_names(text: str | None) -> tuple[str, ...] | None:
    """Return the names in ``"a,b,c"``; None for None, nothing for an empty text."""
    if text is None:
        return None
    return tuple(name.strip() for name in text.split(",") if name.strip())


def results_console() -> Any:
    """A console for results on stdout: as wide as the terminal, wide enough for a table elsewhere."""
    console = terminal()
    return console if console.is_terminal else terminal(width=140)
