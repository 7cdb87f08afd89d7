"""Terms and parameters of white-box models.

A :class:`Term` is one physical effect: an equation whose parameters are zero where the effect is absent.
Friction terms are in ``physics.friction_terms``, those of actuators and sensors in ``physics.path_terms``.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import pi

TWO_WAVES = 4.0 * pi
"""Least phase within the travel, rad, at which a force is periodic along it: two whole waves."""


class Enters(StrEnum):
    """Where in the chain from command to sample an effect enters."""

    RIG = "rig"
    FORCE = "force"
    INPUT = "input"
    OUTPUT = "output"
    ELECTRICAL = "electrical"
    MAGNETIC = "magnetic"
    LOAD = "load"
    DIFFERENCE = "difference"
    """Between a simulated and a measured column; which of the two it changes is not known."""


class CharacteristicScale(StrEnum):
    """The quantity of a recording in units of which the starts of a parameter are given."""

    UNIT = "unit"
    """None: starts are in the unit of the parameter."""
    INPUT = "input"
    """The largest input."""
    INPUT_RATE = "input_rate"
    """The fastest rate of change of the input."""
    DRIVE = "drive"
    """The largest force that the input exerts."""
    SPEED = "speed"
    """The typical speed (RMS) of the moving part."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number to estimate.

    Attributes:
        name: ``term.quantity``, or a bare name for a parameter of the rig itself.
        unit: Its unit.
        scale: Typical size in that unit. A standard error above it means that the data do not identify it.
        lower: Lower bound; above 0 for a size that cannot be zero while its term is in the model.
        upper: Upper bound.
        starts: Values from which a fit begins, besides zero, when the term is added to a model, in units of
            the characteristic scale ``of`` to the ``power``.
        of: The characteristic scale that ``starts`` are given in.
        power: Exponent of that scale: −1 for the inverse of a limit.
        step: Step of finite differences, in scales: wide where the simulation has many kinks.
        shape: True for a parameter without meaning while the level of its term is zero (the Stribeck
            velocity). While the term is absent it stays at ``scale``.
        linear: True if the simulated outputs are affine in it, so that an estimator may project it out.
        in_steps: True if the outputs change with it in steps: only wide differences give a derivative, and
            only a profile gives a confidence interval.
        waves_over: For an order (waves per unit): the coordinate along which the term is periodic.
        joint: Joint, from 0, of a law that several joints have.
        recording: Recording, from 1, of a value that differs between recordings.
    """

    name: str
    unit: str
    scale: float
    lower: float = float("-inf")
    upper: float = float("inf")
    starts: tuple[float, ...] = ()
    of: CharacteristicScale = CharacteristicScale.UNIT
    power: int = 1
    step: float = 1e-4
    shape: bool = False
    linear: bool = False
    in_steps: bool = False
    waves_over: str = ""
    joint: int | None = None
    recording: int | None = None

    @property
    def key(self) -> str:
        """Unique key in a model: the name, with joint and recording where it has them."""
        return keyed(self.name, self.joint, self.recording)

    @property
    def term(self) -> str | None:
        """Key of the term that it belongs to; None for a parameter of the rig itself."""
        term, dot, _ = self.name.partition(".")
        return keyed(term, self.joint) if dot else None

    @property
    def neutral(self) -> float:
        """Value while its term is not in the model."""
        return self.scale if self.shape else 0.0

    @property
    def is_positive(self) -> bool:
        """Whether it is a size that cannot be zero: a mass, a resistance, the length of bristles."""
        return self.lower > 0.0 and not self.shape

    def at_bound(self, value: float) -> bool:
        """Whether a value lies at one of the bounds, up to rounding."""
        near = 1e-9 * self.scale
        return bool(value <= self.lower + near or value >= self.upper - near)


@dataclass(frozen=True, slots=True)
class Term:
    """One physical effect that a model may contain.

    Attributes:
        name: Its name, the same for all rigs and joints.
        enters: Where in the chain from command to sample it enters.
        statement: The effect in a few plain words.
        equation: Its equation; the parameters are its symbols, in order.
        source: Where the equation is from.
        revealed_by: The excitation that shows it.
        parameters: Its parameters with unit and bounds.
        needs: Channels without which the data cannot show it.
        with_terms: Keys of terms that it builds on (Stribeck on Coulomb): a search tries both together as
            well as this one alone.
        joint: Joint, from 0, of a law that several joints have.
        narrow: Key of the term that it becomes at the lower bound of its shape parameter (a Stribeck peak of
            zero width is static friction); "" if there is none.
        known: Constants of the machine, used at their ``scale`` and not estimated.
        statement_if_negative: The statement where its first parameter is negative; "" if that is the same.
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
    joint: int | None = None
    narrow: str = ""
    known: tuple[Parameter, ...] = ()
    statement_if_negative: str = ""

    @property
    def key(self) -> str:
        """Unique key in a model: the name, with the joint in brackets where it has one."""
        return keyed(self.name, self.joint)

    @property
    def order(self) -> Parameter | None:
        """The estimated number of waves per unit of a coordinate; None if the term is not periodic."""
        return next((p for p in self.parameters if p.waves_over), None)

    @property
    def repeats(self) -> Parameter | None:
        """The number of waves per unit of a coordinate, estimated or known; None if not periodic."""
        return next((p for p in (*self.parameters, *self.known) if p.waves_over), None)


def unkeyed(key: str) -> tuple[str, int | None]:
    """Split a key into name and joint, the inverse of :func:`keyed`."""
    name, _, joint = key.removesuffix("]").partition("[")
    return (name, int(joint)) if re.fullmatch("[0-9]{1,4}", joint) else (key, None)


def enumerated(names: Sequence[str]) -> str:
    """Join names for a sentence, with "and" before the last.

    Example:
        >>> enumerated(["a"]), enumerated(["a", "b", "c"])
        ('a', 'a, b and c')
    """
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def why_without_channels(terms: Mapping[str, Term], measured: Collection[str]) -> dict[str, str]:
    """Say of each term which channels it depends on, where a recording lacks one of them.

    Args:
        terms: Terms by key.
        measured: Names of the recorded channels.

    Returns:
        The reasons by the keys of these terms.
    """
    return {k: f"needs {', '.join(t.needs)}" for k, t in terms.items() if not set(t.needs) <= set(measured)}


def listed(keys: Iterable[str]) -> list[str]:
    """Group keys for messages: all joints of a name in one bracket, ``coulomb_friction[0, 1, 2]``."""
    joints: dict[str, list[str]] = {}
    for name, joint in map(unkeyed, keys):
        of = joints.setdefault(name, [])
        of += [] if joint is None else [str(joint)]
    return [f"{name}[{', '.join(of)}]" if of else name for name, of in joints.items()]


def keyed(name: str, joint: int | None, recording: int | None = None) -> str:
    """Make the key of a name: with joint and recording, if any.

    Example:
        >>> keyed("coulomb_friction", 2), keyed("payload.mass", None, 1)
        ('coulomb_friction[2]', 'payload.mass@1')
    """
    key = name if joint is None else f"{name}[{joint}]"
    return key if recording is None else f"{key}@{recording}"
