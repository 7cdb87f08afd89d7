"""What a term of a white-box model is: an equation with parameters that vanish at zero."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import pi

TWO_WAVES = 4.0 * pi
"""Radians: what has not so many within the way is not seen to repeat."""


class Enters(StrEnum):
    """Where in the chain from command to sample an effect comes in."""

    RIG = "rig"
    FORCE = "force"
    INPUT = "input"
    OUTPUT = "output"
    ELECTRICAL = "electrical"
    MAGNETIC = "magnetic"
    LOAD = "load"
    DIFFERENCE = "difference"
    """Between a simulated column and a measured one: on which side it belongs is not known."""


class CharacteristicScale(StrEnum):
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
    is absent it stays at ``scale``. ``linear`` says that the simulated outputs are affine in it, so
    that an estimator may project it out, ``in_steps`` that they change with it in steps, so that only
    wide differences give slopes and only a profile its interval. ``waves_over`` names the coordinate along
    which the term repeats so often per unit (an order). ``joint`` (from 0) distinguishes the same law of
    several joints, ``recording`` (from 1) what has a value of its own in each of several recordings.
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
        """Its name, unique among the parameters of a model: with joint and recording, where it has them."""
        return keyed(self.name, self.joint, self.recording)

    @property
    def term(self) -> str | None:
        """Key of the term that it belongs to; None for a rig's own parameter."""
        term, dot, _ = self.name.partition(".")
        return keyed(term, self.joint) if dot else None

    @property
    def neutral(self) -> float:
        """The value that it has while its term is not in the model."""
        return self.scale if self.shape else 0.0

    def at_bound(self, value: float) -> bool:
        """Whether a value lies at one of the bounds, to rounding."""
        near = 1e-9 * self.scale
        return bool(value <= self.lower + near or value >= self.upper - near)


@dataclass(frozen=True, slots=True)
class Term:
    """One named effect.

    ``needs`` are channels without which the data cannot speak of it; ``revealed_by`` is the
    excitation that shows it; ``with_terms`` are the keys of terms that it builds on (Stribeck on
    Coulomb): they are tried together as well as alone. ``narrow`` is the key of the term that it becomes
    at the lower end of its shape (a Stribeck peak of no width is a mere hold), "" where there is none.
    ``known`` are numbers of the machine that it has at their ``scale``, not to be estimated.
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

    @property
    def key(self) -> str:
        """Its name, unique among the terms of a model: with the joint in brackets."""
        return keyed(self.name, self.joint)

    @property
    def order(self) -> Parameter | None:
        """How often it repeats along a coordinate, estimated; None where it does not."""
        return next((p for p in self.parameters if p.waves_over), None)

    @property
    def repeats(self) -> Parameter | None:
        """The same, estimated or known."""
        return next((p for p in (*self.parameters, *self.known) if p.waves_over), None)


def unkeyed(key: str) -> tuple[str, int | None]:
    """Name and joint that :func:`keyed` made a key of."""
    name, _, joint = key.removesuffix("]").partition("[")
    return (name, int(joint)) if re.fullmatch("[0-9]{1,4}", joint) else (key, None)


def enumerated(names: Sequence[str]) -> str:
    """Names within a sentence.

    Example:
        >>> enumerated(["a"]), enumerated(["a", "b", "c"])
        ('a', 'a, b and c')
    """
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def listed(keys: Iterable[str]) -> list[str]:
    """Keys for people: all joints of a name in one pair of brackets, ``coulomb_friction[0, 1, 2]``."""
    joints: dict[str, list[str]] = {}
    for name, joint in map(unkeyed, keys):
        of = joints.setdefault(name, [])
        of += [] if joint is None else [str(joint)]
    return [f"{name}[{', '.join(of)}]" if of else name for name, of in joints.items()]


def keyed(name: str, joint: int | None, recording: int | None = None) -> str:
    """``coulomb_friction`` of joint 2 is ``coulomb_friction[2]``; what belongs to no joint keeps its name.

    What has a value of its own in a recording names that too: ``payload.mass@1``.
    """
    key = name if joint is None else f"{name}[{joint}]"
    return key if recording is None else f"{key}@{recording}"
