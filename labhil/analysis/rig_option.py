"""The option that names a rig file or a simulator again, for commands that a report advises."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Protocol

from labhil.rig import RigFile, is_simulator

PLACEHOLDER = "RIG.toml"
"""Stands for a rig file that was given in Python and is no file."""


class OfARig(Protocol):
    """A recording of a result."""

    @property
    def rig_file(self) -> str | None:
        """The rig file, or simulator, that was given by name; None for the one in the recording."""


def given_name(rig_file: Path | RigFile | None) -> str | None:
    """Return how the rig file, or simulator, that a user gave is named again; None where none was given."""
    if rig_file is None:
        return None
    path = rig_file.path if isinstance(rig_file, RigFile) else rig_file
    return str(path) if is_simulator(str(path)) or path.is_file() else PLACEHOLDER


def rig_option(source: OfARig) -> str:
    """Return ``" --rig FILE"`` or ``" --simulator FILE"`` as it was given; empty where nothing was.

    A recording without a rig file needs it again, and so does whoever replaced the recording's own.
    """
    if source.rig_file is None:
        return ""
    option = "--simulator" if is_simulator(source.rig_file) else "--rig"
    return f" {option} {shlex.quote(source.rig_file)}"
