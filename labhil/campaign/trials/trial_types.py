"""Types of trial: how many concealed effects, from the catalogue or outside it, and mixtures of types."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labhil.errors import UsageError

BRISTLES = "bristles"
"""The type with a bristle law (or slipping elements) in the place of an event-based dry friction."""

EFFECT_COUNTS: Mapping[str, tuple[int, ...]] = {
    "0": (0,), "1": (1,), "2": (2,), "3": (3,), "hidden": (1,), BRISTLES: (1,),
}  # fmt: skip
MIXTURES: Mapping[str, Mapping[str, float]] = {
    "mixed": {"0": 0.25, "1": 0.35, "2": 0.2, "3": 0.08, "hidden": 0.12},
    "some": {"1": 0.48, "2": 0.24, "3": 0.12, "hidden": 0.16},
}
"""Probability of each type in a mixture; "some" has no nulls."""

TRIAL_TYPES = (*EFFECT_COUNTS, *MIXTURES)


def check_trial_type(name: str) -> None:
    """Check the name of a type of trial.

    Raises:
        UsageError: there is no such type.
    """
    if name not in TRIAL_TYPES:
        raise UsageError(f"--effects: expected one of {', '.join(TRIAL_TYPES)}; found {name!r}")


def draw_trial_type(name: str, rng: np.random.Generator) -> str:
    """Draw the type of one trial from a type or a mixture: a key of ``EFFECT_COUNTS``.

    Raises:
        UsageError: there is no such type.
    """
    check_trial_type(name)
    if name in EFFECT_COUNTS:
        return name
    shares = MIXTURES[name]
    return str(rng.choice(list(shares), p=list(shares.values())))
