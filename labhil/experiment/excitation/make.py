"""Building the excitation of a step from its keys in the experiment file; :data:`EXCITATIONS` lists all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from labhil.errors import UnknownNameError
from labhil.experiment.excitation.fourier import fourier
from labhil.experiment.excitation.function import Excitation, Excitations, Seed
from labhil.experiment.excitation.levels import Steps, hold, prms, staircase, steps
from labhil.experiment.excitation.shift_register import prbs
from labhil.experiment.excitation.table import Between, read_table
from labhil.experiment.excitation.tones import PhaseRule, Sweep, chirp, multisine, two_sine

Numbers = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ExcitationKeys:
    """The keys of a step in the experiment file that shape its excitation; None where not given."""

    frequencies: Numbers | None = None
    amplitude: float | Numbers | None = None
    phases: Numbers | PhaseRule | None = None
    offset: float | None = None
    level: float | None = None
    levels: Numbers | None = None
    dwell: float | None = None
    low: float | Numbers | None = None
    high: float | Numbers | None = None
    count: int | None = None
    stages: int | None = None
    sweep: Sweep | None = None
    there_and_back: bool | None = None
    base_frequency: float | None = None
    harmonics: int | None = None
    centre: float | Numbers | None = None
    speed: float | Numbers | None = None
    acceleration: float | Numbers | None = None
    sine: tuple[Numbers, ...] | None = None
    cosine: tuple[Numbers, ...] | None = None
    path: str | None = None
    between: Between | None = None
    seed: int | None = None

    def given(self) -> dict[str, Any]:
        """Return the keys that were given, with their values."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


def _steps(
    dwell: float,
    levels: Sequence[float] | None = None,
    low: float | None = None,
    high: float | None = None,
    count: int | None = None,
) -> Steps:
    """Return ``levels`` held for ``dwell`` s each, or ``count`` of them from ``low`` to ``high`` and back."""
    if levels is not None and low is None and high is None and count is None:
        return steps(levels, dwell)
    if levels is None and low is not None and high is not None and count is not None:
        return staircase(low, high, count, dwell)
    raise ValueError(
        "excitation 'steps' needs the key `levels`, or `low`, `high` and `count` for a staircase"
    )


@dataclass(frozen=True, slots=True)
class Recipe:
    """How to make one kind of excitation.

    Attributes:
        make: The function that makes it; takes the keys below by name.
        required: Keys of the step that it needs.
        optional: Keys of the step that it also takes.
        context: What it needs to know of the step itself: ``duration``, ``seed``, ``directory``.
    """

    make: Callable[..., Excitation | Excitations]
    required: tuple[str, ...]
    optional: tuple[str, ...] = ()
    context: tuple[str, ...] = ()

    def known_keys(self) -> tuple[str, ...]:
        """Return all keys of a step that it takes."""
        return self.required + self.optional + (("seed",) if "seed" in self.context else ())


EXCITATIONS: Mapping[str, Recipe] = {
    "two_sine": Recipe(two_sine, ("frequencies", "amplitude"), ("phases", "offset")),
    "multisine": Recipe(multisine, ("frequencies", "amplitude"), ("phases", "offset"), ("duration", "seed")),
    "prbs": Recipe(prbs, ("low", "high", "dwell"), ("stages",), ("duration", "seed")),
    "prms": Recipe(prms, ("low", "high", "count", "dwell"), (), ("duration", "seed")),
    "chirp": Recipe(
        chirp, ("frequencies", "amplitude"), ("phases", "offset", "sweep", "there_and_back"), ("duration",)
    ),
    "steps": Recipe(_steps, ("dwell",), ("levels", "low", "high", "count")),
    "fourier": Recipe(
        fourier,
        ("low", "high", "speed", "acceleration", "base_frequency"),
        ("harmonics", "centre", "sine", "cosine"),
        ("duration", "seed"),
    ),
    "hold": Recipe(hold, ("level",)),
    "file": Recipe(read_table, ("path",), ("between",), ("directory",)),
}
"""The recipe of each excitation, by name."""

SCALAR_KEYS = {"low": ("prbs", "prms", "steps"), "high": ("prbs", "prms", "steps")}
"""Keys that are lists for other excitations, and single numbers for these."""


def make_excitation(
    name: str, keys: ExcitationKeys, duration: float, seed: Seed = 0, directory: Path = Path()
) -> Excitation | Excitations:
    """Build the excitation of a step.

    Args:
        name: One of :data:`EXCITATIONS`.
        keys: The keys of the step.
        duration: Duration of the step, s.
        seed: Seed of random values, unless ``keys`` have their own.
        directory: Where relative paths begin.

    Raises:
        UnknownNameError: There is no such excitation; the message lists them.
        ValueError: A key is missing, does not belong to this excitation, or has a wrong value.
    """
    given = check_keys(name, keys)
    recipe = EXCITATIONS[name]
    context = {"duration": duration, "seed": given.pop("seed", seed), "directory": directory}
    return recipe.make(**given, **{key: context[key] for key in recipe.context})


def check_keys(name: str, keys: ExcitationKeys) -> dict[str, Any]:
    """Return the keys given for the excitation ``name``; raises what :func:`make_excitation` raises."""
    if name not in EXCITATIONS:
        raise UnknownNameError("excitation", name, EXCITATIONS)
    recipe, given = EXCITATIONS[name], keys.given()
    for key in recipe.required:
        if key not in given:
            raise ValueError(f"excitation {name!r} needs the key `{key}`")
    for key, value in given.items():
        if key not in recipe.known_keys():
            known = ", ".join(recipe.known_keys())
            raise ValueError(f"excitation {name!r} has no key `{key}`; it takes: {known}")
        if name in SCALAR_KEYS.get(key, ()) and not isinstance(value, (int, float)):
            raise ValueError(f"`{key}` of {name} must be one number, found {len(value)}")
    return given
