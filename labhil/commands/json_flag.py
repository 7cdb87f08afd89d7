"""``--json`` of commands that print their result as JSON: a path, ``-`` for stdout, or nothing for stdout."""

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
    """A command whose ``--json`` may stand alone; what follows is its path if it is - or ends in .json."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a ``--json`` that stands alone the path that means stdout."""
        expanded: list[str] = []
        for place, arg in enumerate(args):
            expanded.append(arg)
            following = args[place + 1] if place + 1 < len(args) else ""
            if arg == "--json" and following != "-" and not following.endswith(".json"):
                expanded.append("-")
        return super().parse_args(ctx, expanded)
