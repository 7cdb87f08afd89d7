"""Names of a simulator's file as names in labhil."""

from __future__ import annotations

import re


def identifier(text: str) -> str:
    """A name of letters, digits and _ that is near to any text."""
    name = re.sub(r"\W+", "_", text).strip("_") or "mechanism"
    return name if not name[0].isdigit() else f"_{name}"


NO_PORT = "a column of outputs has no place where a force acts; give the simulator itself"
"""Why forces are left open where only a simulation's output is at hand."""
