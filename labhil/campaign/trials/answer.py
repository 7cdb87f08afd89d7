"""The answer in an envelope: every difference between plant and baseline model, and how large it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from labhil.campaign.trials.noise import TrueNoise
from labhil.physics.terms import keyed

SCHEMA = "labhil.answer/1"


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """An effect that the baseline lacks.

    Attributes:
        term: its name.
        joint: its joint, None for an effect of the whole plant.
        catalogue: whether the rig's model has a term of that name.
        plant: the plant's parameters by full name.
        parameters: the model's parameters by key, where they correspond to the plant's.
        strength: test RMSE, over the noise floor, of a refit of baseline and all other true effects.
        oracle_gain: log likelihood (nats) that the effect adds on the test data.
    """

    term: str
    joint: int | None
    catalogue: bool
    plant: Mapping[str, float]
    parameters: Mapping[str, float]
    strength: float
    oracle_gain: float

    @property
    def key(self) -> str:
        """Its name with the joint."""
        return keyed(self.term, self.joint)


@dataclass(frozen=True, slots=True)
class Answer:
    """The truth of a trial.

    Attributes:
        trial: name of the trial.
        rig: the kind of rig.
        recordings: SHA-256 of the recordings by role.
        baseline: terms of the baseline model.
        effects: the concealed effects.
        truth: true values of the model's parameters by key.
        noise: true noise of the outputs.
        noise_floors: RMSE of a perfect model by output, in its unit.
        baseline_strength: test RMSE of the refitted baseline over the noise floor.
        conditions: conditions of the recordings.
        plant: parameters of the plant by full name.
    """

    trial: str
    rig: str
    recordings: Mapping[str, str]
    baseline: tuple[str, ...]
    effects: tuple[TrueEffect, ...]
    truth: Mapping[str, float]
    noise: TrueNoise
    noise_floors: Mapping[str, float]
    baseline_strength: float
    conditions: Mapping[str, Any]
    plant: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """Return the answer as plain JSON data."""
        return {"schema": SCHEMA, **asdict(self), "noise": self.noise.to_json()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Answer:
        """Read what :meth:`to_json` wrote."""
        fields = {key: value for key, value in data.items() if key != "schema"}
        effects = tuple(TrueEffect(**effect) for effect in fields.pop("effects"))
        noise = TrueNoise.from_json(fields.pop("noise"))
        return cls(**{**fields, "baseline": tuple(fields["baseline"])}, effects=effects, noise=noise)
