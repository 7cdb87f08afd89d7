"""Names of signals and parameters from the names in a simulator's file."""

from __future__ import annotations

import re


def identifier(text: str) -> str:
    """Turn any text into a name of letters, digits and _."""
    name = re.sub(r"\W+", "_", text).strip("_") or "mechanism"
    return name if not name[0].isdigit() else f"_{name}"


NO_PORT = "a column of outputs has no place where a force acts; give the simulator itself"
"""Why forces cannot be observed in a column of simulated outputs."""
