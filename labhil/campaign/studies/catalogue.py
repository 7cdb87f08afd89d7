"""The catalogue of a rig kind (terms and estimators), read in a separate process: loading takes seconds.

``python -m labhil.campaign.studies.catalogue`` reads a rig kind in one line and answers in one.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labhil.campaign.studies.process import read_further_lines, read_request, write_line
from labhil.errors import LabhilError

MODULE = "labhil.campaign.studies.catalogue"


@dataclass(frozen=True, slots=True)
class TermEntry:
    """A term in the catalogue."""

    name: str
    statement: str
    equation: str
    revealed_by: str
    needs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The terms of a rig kind, those of its default model, and the estimators."""

    baseline: tuple[str, ...]
    general: tuple[str, ...]
    effects: tuple[TermEntry, ...]
    estimators: tuple[str, ...]

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Catalogue:
        """Read the answer of this process; the same law in several joints is one term."""
        effects = {
            term["term"]: TermEntry(
                term["term"],
                term["statement"],
                term["equation"],
                term["revealed_by"],
                tuple(term["needs"]),
            )
            for term in data["terms"]
        }
        return cls(
            tuple(data["baseline"]),
            tuple(data["general"]),
            tuple(effects.values()),
            tuple(data["estimators"]),
        )


def main() -> int:
    """Run the process; returns its exit status."""
    rig = str(read_request()["rig"])
    read_further_lines(lambda _line: None, lambda: os._exit(0))
    from labhil.identify.estimators import DEFAULT, ESTIMATORS
    from labhil.report.catalogue import catalogue_json

    try:
        (entry,) = catalogue_json(rig)["rigs"].values()
    except LabhilError as error:
        write_line({"failed": str(error)})
        return error.exit_status
    alternatives = [name for name in ESTIMATORS if name != DEFAULT]
    write_line({"done": {**entry, "estimators": [DEFAULT, *alternatives]}})
    return 0


if __name__ == "__main__":
    sys.exit(main())
