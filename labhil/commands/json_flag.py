"""Commands whose result goes to stdout as JSON by a plain ``--json``: ``--json -`` says the same there."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand


class JsonFlagCommand(TyperCommand):
    """A command with the flag ``--json``, which may be followed by ``-`` as it is everywhere else."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take ``-`` for what it is there: no argument."""
        taken: list[str] = []
        for arg in args:
            if arg == "-" and taken[-1:] == ["--json"]:
                continue
            taken.append("--json" if arg == "--json=-" else arg)
        return super().parse_args(ctx, taken)
