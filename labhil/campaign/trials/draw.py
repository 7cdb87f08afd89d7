"""Which sort of trial is drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labhil.errors import UsageError

COUNTS: Mapping[str, tuple[int, ...]] = {"0": (0,), "1": (1,), "2": (2,), "3": (3,), "hidden": (1,)}
MIXTURE = {"0": 0.25, "1": 0.35, "2": 0.2, "3": 0.08, "hidden": 0.12}
"""How often each sort of trial is drawn where nobody asks for one sort."""


def draw_sort(wanted: str, random: np.random.Generator) -> str:
    """One sort of trial: "0" to "3" effects of the catalogue, or "hidden"; UsageError for another word."""
    if wanted == "mixed":
        return str(random.choice(list(MIXTURE), p=list(MIXTURE.values())))
    if wanted not in COUNTS:
        raise UsageError(f"--effects: expected one of {', '.join(COUNTS)}, mixed; found {wanted!r}")
    return wanted
