"""What `labhil reference` does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from labhil.atomic_file import atomic_file, write_json_file
from labhil.terminal import terminal
from labhil_benchmarks.reference.page import page
from labhil_benchmarks.reference.published import NUMBERS
from labhil_benchmarks.reference.result import Reference
from labhil_benchmarks.reference.run import Progress, run_reference
from labhil_benchmarks.reference.show import show_reference

WIDTH = 200
"""Columns of the widest table where nobody says how wide the terminal is."""


def reference_command(
    tables: Sequence[str] = NUMBERS,
    *,
    quick: bool = False,
    seed: int = 0,
    cache: Path | None = Path("labhil-reference"),
    markdown: Path | None = None,
    json_path: Path | None = None,
    progress: Progress = lambda text: None,
    console: Console | None = None,
) -> Reference:
    """Fill the tables, show them on stdout, write page and JSON where asked.

    Finished parts stay in the folder ``cache``, so that an interrupted run goes on where it was. Raises
    UnknownNameError for a table that does not exist.
    """
    reference = run_reference(tables, quick=quick, seed=seed, progress=progress, cache=cache)
    if markdown is not None:
        with atomic_file(markdown, "the page") as draft:
            draft.write_text(page(reference), encoding="utf-8")
    if json_path is not None:
        write_json_file(reference.to_json(), json_path)
    # what was asked for is saved by now, whatever becomes of stdout
    shown = console or terminal()
    shown = shown if shown.is_terminal else terminal(file=shown.file, width=WIDTH)
    shown.print(show_reference(reference))
    return reference
