"""What all commands share: results to stdout or a file, everything else to stderr."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from labhil.errors import UsageError
from labhil.terminal import complain, printable, printable_json, show, terminal
from labhil.whole import whole


def write_json(data: dict[str, Any], path: Path | None = None) -> None:
    """Write a result as JSON, to stdout or a file; numbers that are not finite have been made None before."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, indent=1)
    if path is None:
        show(printable_json(text))
        return
    with whole(path, "the result") as draft:
        draft.write_text(text + "\n", encoding="utf-8")


def refuse_unwritable(*paths: Path | None) -> None:
    """Raise UsageError for a result's path that cannot be a file there, before the work and not after it."""
    for path in paths:
        if path is not None and path.is_dir():
            raise UsageError(f"{path}: expected a file to write, found a folder")
        if path is not None and not path.parent.is_dir():
            raise UsageError(f"{path}: expected a folder {path.parent} to write into, found none")


def tell(lines: Iterable[str]) -> None:
    """Print what a person should know beside the result."""
    complain(*lines)


def split_names(text: str | None) -> tuple[str, ...] | None:
    """Return the names in ``"a,b,c"``; None for None, nothing for an empty text."""
    if text is None:
        return None
    return tuple(name.strip() for name in text.split(",") if name.strip())


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Show what is being done on stderr: a line that changes on a terminal, lines elsewhere."""
    console = terminal(stderr=True)
    if not console.is_terminal:
        yield lambda text: console.print(text, highlight=False, soft_wrap=True)
        return
    from rich.text import Text

    # a bare string would be read as markup there
    with console.status(Text("starting")) as line:
        yield lambda text: line.update(Text(printable(text)))


def results_console() -> Any:
    """A console for results on stdout: as wide as the terminal, wide enough for a table elsewhere."""
    console = terminal()
    return console if console.is_terminal else terminal(width=140)
