"""What is in an envelope: every difference between a plant and the declared baseline, and how large it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from labhil.campaign.trials.noise import TrueNoise
from labhil.physics.terms import keyed

SCHEMA = "labhil.answer/1"


@dataclass(frozen=True, slots=True)
class TrueEffect:
    """One effect that the baseline lacks.

    ``catalogue`` says whether the rig's model has a term of that name; ``plant`` are the plant's numbers
    by full name and ``parameters`` the model's, by key, where the two correspond. ``strength`` is the test
    RMSE of the baseline with all other true effects, refitted, over the noise floor; ``oracle_gain`` the
    log likelihood (nats) that the effect is worth on the test data.
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
        """Its name with the joint, where it is in one."""
        return keyed(self.term, self.joint)


@dataclass(frozen=True, slots=True)
class Answer:
    """A trial's truth.

    ``recordings`` are the SHA-256 of search and test; ``truth`` the values of the fitted model's
    parameters, by key; ``noise_floors`` the RMSE of a perfect model by output, in its unit;
    ``baseline_strength`` the test RMSE of the refitted baseline over the noise floor.
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
        """As plain JSON data."""
        return {"schema": SCHEMA, **asdict(self), "noise": self.noise.to_json()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Answer:
        """Read what :meth:`to_json` wrote."""
        rest = {key: value for key, value in data.items() if key != "schema"}
        effects = tuple(TrueEffect(**effect) for effect in rest.pop("effects"))
        noise = TrueNoise.from_json(rest.pop("noise"))
        return cls(**{**rest, "baseline": tuple(rest["baseline"])}, effects=effects, noise=noise)
