"""From the settings of an experiment file's step to its excitation."""

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
    """The settings of an experiment file's step that shape an excitation; None where not given."""

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
        """Return what was given, by name."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in named.items() if value is not None}


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
    """What makes an excitation, and of what.

    The keys that it ``needs``, those that it can do ``without``, and what of its surroundings it
    ``takes`` (``duration``, ``seed``, ``directory``).
    """

    make: Callable[..., Excitation | Excitations]
    needs: tuple[str, ...]
    without: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()

    def understood(self) -> tuple[str, ...]:
        """Return the keys of a step that it understands."""
        return self.needs + self.without + (("seed",) if "seed" in self.takes else ())


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
"""How each is made, by name."""

SCALAR = {"low": ("prbs", "prms", "steps"), "high": ("prbs", "prms", "steps")}
"""Keys that may be a list, but not for these."""


def make_excitation(
    name: str, keys: ExcitationKeys, duration: float, seed: Seed = 0, directory: Path = Path()
) -> Excitation | Excitations:
    """Build the excitation ``name`` for a step of ``duration`` s.

    ``seed`` begins what is drawn unless the keys hold one of their own; paths are relative to
    ``directory``. Raises UnknownNameError, with the names there are, and ValueError for a setting that
    is missing, does not belong to this excitation, or has a wrong value.
    """
    given = check_keys(name, keys)
    recipe = EXCITATIONS[name]
    around = {"duration": duration, "seed": given.pop("seed", seed), "directory": directory}
    return recipe.make(**given, **{key: around[key] for key in recipe.takes})


def check_keys(name: str, keys: ExcitationKeys) -> dict[str, Any]:
    """Return the keys given for the excitation ``name``; raises as :func:`make_excitation` does."""
    if name not in EXCITATIONS:
        raise UnknownNameError("excitation", name, EXCITATIONS)
    recipe, given = EXCITATIONS[name], keys.given()
    for key in recipe.needs:
        if key not in given:
            raise ValueError(f"excitation {name!r} needs the key `{key}`")
    for key, value in given.items():
        if key not in recipe.understood():
            takes = ", ".join(recipe.understood())
            raise ValueError(f"excitation {name!r} has no key `{key}`; it takes: {takes}")
        if name in SCALAR.get(key, ()) and not isinstance(value, (int, float)):
            raise ValueError(f"`{key}` of {name} must be one number, found {len(value)}")
    return given
