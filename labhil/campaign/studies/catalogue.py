"""The terms and estimators of a rig kind for fits and diagnoses, in a process of its own.

Reading models takes seconds. ``python -m labhil.campaign.studies.catalogue`` takes a rig kind in one line
and answers in one.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labhil.campaign.studies.process import on_further_lines, read_request, say
from labhil.errors import LabhilError

MODULE = "labhil.campaign.studies.catalogue"


@dataclass(frozen=True, slots=True)
class Effect:
    """A term in the catalogue's words."""

    name: str
    statement: str
    equation: str
    revealed_by: str
    needs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The terms of a rig kind, those that are taken by default, and the estimators."""

    baseline: tuple[str, ...]
    general: tuple[str, ...]
    effects: tuple[Effect, ...]
    estimators: tuple[str, ...]

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Catalogue:
        """Read what this process answers; the same law of several joints is one term."""
        effects = {
            term["term"]: Effect(
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
    on_further_lines(lambda _line: None, lambda: os._exit(0))
    from labhil.identify.estimators import DEFAULT, ESTIMATORS
    from labhil.report.catalogue import catalogue_json

    try:
        (entry,) = catalogue_json(rig)["rigs"].values()
    except LabhilError as error:
        say({"failed": str(error)})
        return error.exit_status
    alternatives = [name for name in ESTIMATORS if name != DEFAULT]
    say({"done": {**entry, "estimators": [DEFAULT, *alternatives]}})
    return 0


if __name__ == "__main__":
    sys.exit(main())
