"""The option ``--json`` of commands that print JSON: with a path, with ``-``, or alone for stdout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="[PATH]", help="Write the result here as JSON; without a path to stdout."),
]


class JsonFlagCommand(TyperCommand):
    """Accept ``--json`` without a path; the next argument is its path if it is - or ends in .json."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert ``-`` after a ``--json`` without a path."""
        expanded: list[str] = []
        for place, arg in enumerate(args):
            expanded.append(arg)
            following = args[place + 1] if place + 1 < len(args) else ""
            if arg == "--json" and following != "-" and not following.endswith(".json"):
                expanded.append("-")
        return super().parse_args(ctx, expanded)
