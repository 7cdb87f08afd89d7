"""Which sort of trial is drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labhil.errors import UsageError

BRISTLES = "bristles"
"""A dry friction that bristles or slipping elements carry, in the place of an event-based law."""

COUNTS: Mapping[str, tuple[int, ...]] = {
    "0": (0,), "1": (1,), "2": (2,), "3": (3,), "hidden": (1,), BRISTLES: (1,),
}  # fmt: skip
MIXTURES: Mapping[str, Mapping[str, float]] = {
    "mixed": {"0": 0.25, "1": 0.35, "2": 0.2, "3": 0.08, "hidden": 0.12},
    "some": {"1": 0.48, "2": 0.24, "3": 0.12, "hidden": 0.16},
}
"""How often each sort of trial is drawn from a mixture; "some" are all but nulls."""

SORTS = (*COUNTS, *MIXTURES)


def refuse_unknown_sort(wanted: str) -> None:
    """UsageError for a word that is no sort of trial."""
    if wanted not in SORTS:
        raise UsageError(f"--effects: expected one of {', '.join(SORTS)}; found {wanted!r}")


def draw_sort(wanted: str, random: np.random.Generator) -> str:
    """One sort of trial: "0" to "3" effects of the catalogue, or "hidden"; UsageError for another word."""
    refuse_unknown_sort(wanted)
    if wanted in COUNTS:
        return wanted
    shares = MIXTURES[wanted]
    return str(random.choice(list(shares), p=list(shares.values())))
