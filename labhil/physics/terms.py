"""What a term of a white-box model is: an equation with parameters that vanish at zero."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class Enters(StrEnum):
    """Where in the chain from command to sample an effect comes in."""

    RIG = "rig"
    FORCE = "force"
    INPUT = "input"
    OUTPUT = "output"
    ELECTRICAL = "electrical"
    MAGNETIC = "magnetic"
    LOAD = "load"


class Yardstick(StrEnum):
    """What in a recording the starts of a parameter are fractions of."""

    UNIT = "unit"
    """Nothing: the parameter's own unit."""
    INPUT = "input"
    """The largest input."""
    INPUT_RATE = "input_rate"
    """The fastest change of the input per second."""
    DRIVE = "drive"
    """The largest force that the input exerts."""
    SPEED = "speed"
    """The typical speed (RMS) of the moving part."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number to estimate.

    ``scale`` is a typical size in its unit: a standard error beyond it means that the data do not
    know this parameter. ``starts`` are the values from which a fit begins, besides zero, when the
    term joins a model, in units of what ``of`` names in the recording at
    hand (to the ``power``: −1 for one over a limit). ``step`` is the difference, in scales, with
    which slopes are taken: wide where the simulation has kinks close to each other. ``shape`` marks a
    parameter that has no meaning while its term's level is zero (Stribeck velocity): while the term
    is absent it stays at ``scale``.
    """

    name: str
    unit: str
    scale: float
    lower: float = float("-inf")
    upper: float = float("inf")
    starts: tuple[float, ...] = ()
    of: Yardstick = Yardstick.UNIT
    power: int = 1
    step: float = 1e-4
    shape: bool = False

    @property
    def neutral(self) -> float:
        """The value that it has while its term is not in the model."""
        return self.scale if self.shape else 0.0


@dataclass(frozen=True, slots=True)
class Term:
    """One named effect.

    ``needs`` are channels without which the data cannot speak of it; ``revealed_by`` is the
    excitation that shows it; ``with_terms`` names terms that it builds on (Stribeck on Coulomb):
    they are tried together as well as alone.
    """

    name: str
    enters: Enters
    statement: str
    equation: str
    source: str
    revealed_by: str
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...] = ()
    with_terms: tuple[str, ...] = field(default=())

    def parameter_names(self) -> tuple[str, ...]:
        """Names of its parameters, ``term.parameter``."""
        return tuple(parameter.name for parameter in self.parameters)


def term_of(parameter_name: str) -> str | None:
    """``coulomb_friction.level`` belongs to ``coulomb_friction``; a rig's own parameter to none."""
    term, dot, _ = parameter_name.partition(".")
    return term if dot else None
