"""What a trial conceals, and the interfaces of a bench and of its setup in one trial.

The benches are in ``arm.py`` and ``one_input_rigs.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from labhil.campaign.trials.disturbance import Disturbance
from labhil.campaign.trials.noise import TrueNoise
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.physics.rigs import rig_model
from labhil.physics.terms import keyed
from labhil.signals import FloatArray, Signal


@dataclass(frozen=True, slots=True)
class DrawnEffect:
    """An effect of the plant, as it was drawn.

    Attributes:
        term: its name: the model's term, where there is one.
        parameters: values (SI) by the plant's full names.
        powers: exponent (−1, 0 or 1) of the strength with which each parameter grows.
        target_strength: strength to scale it to, in the outputs of its joint or in all of them.
        joint: its joint, None for an effect of the whole plant.
    """

    term: str
    parameters: Mapping[str, float]
    powers: Mapping[str, int]
    target_strength: float
    joint: int | None = None

    @property
    def key(self) -> str:
        """Key of the term: its name with the joint."""
        return keyed(self.term, self.joint)

    @property
    def is_dry_friction(self) -> bool:
        """Whether it is a dry friction that a bristle law can replace."""
        return self.term in ("coulomb_friction", "stribeck_friction")

    def scaled(self, factor: float) -> DrawnEffect:
        """Return the effect, stronger by a factor."""
        scale = {-1: 1.0 / factor, 0: 1.0, 1: factor}
        return replace(self, parameters={k: v * scale[self.powers[k]] for k, v in self.parameters.items()})


@dataclass(frozen=True, slots=True)
class Secret:
    """All that a trial conceals.

    Attributes:
        setup: the rig with the conditions of the trial.
        base: the plant's parameters of the baseline model (SI).
        effects: the concealed effects.
        disturbance: a disturbance that no model has.
    """

    setup: Setup
    base: Mapping[str, float]
    effects: tuple[DrawnEffect, ...] = ()
    disturbance: Disturbance | None = None

    @property
    def kind(self) -> str:
        """The kind of rig."""
        return self.setup.kind

    @property
    def terms(self) -> tuple[str, ...]:
        """Keys of the baseline's terms and of the effects."""
        return (*rig_model(self.kind).baseline, *(effect.key for effect in self.effects))

    @property
    def parameters(self) -> dict[str, float]:
        """The plant's parameters other than its defaults, by full name."""
        return dict(self.base) | {k: v for effect in self.effects for k, v in effect.parameters.items()}


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """A simulated recording: stamps (n,) s, the commands, and signals, (n,) or (n, width), by name; SI."""

    t: FloatArray
    commands: FloatArray
    signals: Mapping[str, FloatArray]


class Setup(Protocol):
    """A rig with the conditions of one trial: how it is driven, sampled and measured."""

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
        """The recorded signals."""
        ...

    def conditions_to_json(self) -> dict[str, Any]:
        """Return the conditions as plain JSON data."""
        ...

    def draw_baseline_parameters(self, rng: np.random.Generator) -> dict[str, float]:
        """Draw the baseline's parameters about the plant's defaults."""
        ...

    def draw_effect(
        self, model: Model, outside: bool, others: Sequence[DrawnEffect], rng: np.random.Generator
    ) -> DrawnEffect:
        """Draw an effect beside others: one that the model can name, or one ``outside`` its catalogue."""
        ...

    def draw_carrier(self, dry: DrawnEffect, rng: np.random.Generator) -> DrawnEffect:
        """Draw a bristle law that replaces the event-based law of a dry friction."""
        ...

    def plant_parameters(self, secret: Secret) -> Mapping[str, float]:
        """Return every parameter of the plant, its defaults included."""
        ...

    def true_noise(self, secret: Secret) -> TrueNoise:
        """Return noise and steps of the outputs."""
        ...

    def simulate(self, secret: Secret, noise: TrueNoise, recording_index: int) -> SimulatedRun:
        """Simulate the search (0) or the test (1) recording.

        Raises:
            UsageError: the plant cannot be run like that.
        """
        ...

    def simulate_noiseless(self, secret: Secret, run: SimulatedRun, recording_index: int) -> SimulatedRun:
        """Simulate a run again with outputs without noise and steps."""
        ...

    def to_record(self, run: SimulatedRun) -> Record:
        """Return a run as the record of a model, before the model prepares it."""
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

    def draw_setup(self, rng: np.random.Generator) -> Setup:
        """Draw the conditions of a trial."""
        ...

    def with_duration(self, seconds: float) -> Bench:
        """Return the bench with recordings of this duration, s."""
        ...
