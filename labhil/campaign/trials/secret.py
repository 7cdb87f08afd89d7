"""What a trial conceals, and the interface of a rig that is recorded in one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from labhil.campaign.trials.disturbed import Disturbance
from labhil.campaign.trials.noise import TrueNoise
from labhil.physics.model import Model, Record
from labhil.physics.rigs import rig_model
from labhil.physics.terms import keyed
from labhil.signals import FloatArray, Signal


@dataclass(frozen=True, slots=True)
class Drawn:
    """An effect of the plant: its name (the model's, where it has one), its joint, the plant's parameters.

    ``parameters`` (SI, by the plant's own full names) grow with the powers ``powers`` (−1, 0 or 1) of the
    strength; ``target`` is the strength that it is to have in the outputs of its joint, in all of them where
    it has none.
    """

    term: str
    parameters: Mapping[str, float]
    powers: Mapping[str, int]
    target: float
    joint: int | None = None

    @property
    def key(self) -> str:
        """Its name with the joint, as the model's terms are called."""
        return keyed(self.term, self.joint)

    @property
    def dry(self) -> bool:
        """Whether it is a dry friction that bristles can carry."""
        return self.term in ("coulomb_friction", "stribeck_friction")

    def scaled(self, factor: float) -> Drawn:
        """The same effect, stronger by a factor."""
        by = {-1: 1.0 / factor, 0: 1.0, 1: factor}
        return replace(self, parameters={k: v * by[self.powers[k]] for k, v in self.parameters.items()})


@dataclass(frozen=True, slots=True)
class Secret:
    """All that is concealed: how the rig is set up, the baseline's numbers, the effects, what disturbs."""

    setup: Setup
    base: Mapping[str, float]
    effects: tuple[Drawn, ...] = ()
    disturbance: Disturbance | None = None

    @property
    def kind(self) -> str:
        """The kind of rig."""
        return self.setup.kind

    @property
    def terms(self) -> tuple[str, ...]:
        """What it is made of, as the model's terms are called."""
        return (*rig_model(self.kind).baseline, *(effect.key for effect in self.effects))

    @property
    def parameters(self) -> dict[str, float]:
        """The plant's numbers other than its defaults, by full name."""
        return dict(self.base) | {k: v for effect in self.effects for k, v in effect.parameters.items()}


@dataclass(frozen=True, slots=True)
class Walk:
    """What happened: stamps (n,) s, what was commanded, and signals, (n,) or (n, width), by name; SI."""

    t: FloatArray
    commands: FloatArray
    signals: Mapping[str, FloatArray]


class Setup(Protocol):
    """A rig as it stands in one trial: under which conditions it is driven, sampled and measured."""

    @property
    def kind(self) -> str:
        """The kind of rig."""
        ...

    @property
    def rig(self) -> str:
        """The rig file's text."""
        ...

    @property
    def period(self) -> float:
        """Time between samples, s."""
        ...

    @property
    def signals(self) -> tuple[Signal, ...]:
        """What is recorded."""
        ...

    def conditions_to_json(self) -> dict[str, Any]:
        """The conditions as an answer lists them."""
        ...

    def draw_base(self, random: np.random.Generator) -> dict[str, float]:
        """The baseline's numbers, spread about the plant's defaults."""
        ...

    def draw_effect(
        self, model: Model, outside: bool, others: Sequence[Drawn], random: np.random.Generator
    ) -> Drawn:
        """An effect of random kind and size to join others: one that the model can name, or one ``outside``.

        Its strength is one to be scaled to.
        """
        ...

    def draw_carrier(self, dry: Drawn, random: np.random.Generator) -> Drawn:
        """What carries a drawn dry friction in the place of an event-based law."""
        ...

    def numbers(self, secret: Secret) -> Mapping[str, float]:
        """Every number of the plant, its defaults included."""
        ...

    def noise_scale(self, secret: Secret) -> TrueNoise:
        """Noise and steps of the outputs."""
        ...

    def walk(self, secret: Secret, noise: TrueNoise, which: int) -> Walk:
        """Record the search (0) or the test (1). UsageError where the plant cannot be run like that."""
        ...

    def silent(self, secret: Secret, walk: Walk, which: int) -> Walk:
        """The same walk again with outputs that are measured without noise and steps."""
        ...

    def record(self, walk: Walk) -> Record:
        """The walk as a model sees it, before the model prepares it."""
        ...


class Bench(Protocol):
    """A kind of rig that trials are recorded on."""

    @property
    def kind(self) -> str:
        """The kind of rig."""
        ...

    @property
    def rig(self) -> str:
        """The rig file's text."""
        ...

    def setup(self, random: np.random.Generator) -> Setup:
        """The rig under random conditions."""
        ...

    def lasting(self, seconds: float) -> Bench:
        """The same with recordings that are so long, s."""
        ...
