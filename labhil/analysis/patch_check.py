"""The held-out data of a result, and the errors that simulators of one coordinate make on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from labhil.analysis.dataset import Dataset
from labhil.analysis.patch import MAX_ERROR_RATIO, MAX_STATED_RATIO, Attempt
from labhil.analysis.patch_source import PatchSource
from labhil.errors import UsageError
from labhil.identify.score import Score, score
from labhil.identify.windows import noise_of
from labhil.physics.model import Model, index_of, start_values
from labhil.physics.record import Record
from labhil.physics.warming import TEMPERATURE
from labhil.python_file import object_of
from labhil.rig import RigFile, default_rig
from labhil.simulators.companion import SortedEffects, sort_effects
from labhil.simulators.rolled_out import RolledOutModel
from labhil.simulators.simulator import Simulator
from labhil.simulators.stepped import JointForce, SteppedSimulator

DRY_FRICTION_TERMS = (
    "coulomb_friction",
    "static_friction",
    "position_dependent_friction",
    "load_dependent_friction",
)


@dataclass(frozen=True, slots=True)
class PatchCheck:
    """Held-out data and the error of the diagnosed model on them.

    Attributes:
        source: The result.
        into: The original file.
        dataset: Its recordings.
        model: The error of the diagnosed model.
        horizon: Length of the simulated windows, s.
        values: All values, those that the rig file states included.
    """

    source: PatchSource
    into: Path
    dataset: Dataset
    model: Score
    horizon: float
    values: Mapping[str, float]

    @classmethod
    def of(cls, source: PatchSource, into: Path, rig: RigFile, holdout: float) -> PatchCheck:
        """Load the recordings of a result and score the diagnosed model.

        Raises:
            UsageError: The result is not of this file, or its values make a larger error than it states.
        """
        if source.horizon is None:
            raise UsageError(
                f"{source.path}: expected a simulation of {into}, found inverse dynamics of another file"
            )
        dataset = source.load_dataset(rig, holdout)
        model = _score(dataset.model, dataset, source.values, source.horizon)
        if model.rmse > MAX_STATED_RATIO * source.promised:
            raise UsageError(
                f"{source.path}: promises an error of {source.promised:.4g} on held-out data, and its values "
                f"in {into} make one of {model.rmse:.4g}: was it made with another file, --rig or --holdout?"
            )
        known = {name: x for name in rig.kind.known if (x := rig.known_number(name)) is not None}
        return cls(source, into, dataset, model, source.horizon, {**known, **source.values})

    @property
    def unit(self) -> str:
        """Unit of the errors."""
        channels = self.model.channels
        return channels[0].unit if len(channels) == 1 else "noise floors"

    def rmse_of(self, simulator: Simulator, values: Mapping[str, float]) -> float:
        """RMSE of a simulator that runs by itself; ``values`` are effects of its input and sensor."""
        model = RolledOutModel(simulator, default_rig(simulator.name), self.dataset.test)
        return _score(model, self.dataset, values, self.horizon).rmse

    def attempt(self, remedy: str, rmse: float) -> Attempt:
        """Compare the error of a candidate with that of the diagnosed model."""
        return Attempt(remedy, rmse, rmse / self.model.rmse)

    def refusal(self, attempts: list[Attempt]) -> UsageError:
        """Make the error where no candidate is good enough."""
        tried = "; ".join(f"{a.beside or 'as it is'}: {a.rmse:.4g} ({a.ratio:.2f} times)" for a in attempts)
        return UsageError(
            f"{self.into}: expected the repaired file to make an error of {self.model.rmse:.4g} on held-out "
            f"data, or up to {MAX_ERROR_RATIO:g} times that, found {tried}; nothing is written"
        )


def refusal_of_unknown(into: Path, terms: tuple[str, ...]) -> UsageError:
    """Make the error where a file can hold some effects in no way."""
    return UsageError(
        f"{into}: no way is known to write {', '.join(terms)} of this size into a file (correct an inertia "
        "in the body or the parameter); nothing is written"
    )


def companion_force(text: str, code: Path, effects: SortedEffects, record: Record) -> JointForce:
    """Write a companion to a temporary file, and return its function ``force`` along a recording."""
    code.write_text(text, encoding="utf-8")
    force = cast("Callable[..., float]", object_of(f"{code.name}:force", code.parent))
    if not effects.needs_temperature:
        return lambda t, x, v, drive: force(x, v, drive)
    warmth = record.auxiliary[TEMPERATURE]
    return lambda t, x, v, drive: force(x, v, drive, float(np.interp(t, record.t, warmth)))


def inertia_felt_by_input(simulator: SteppedSimulator, numbers: Sequence[float]) -> float:
    """Input per acceleration of a simulator at rest, at these values of its parameters."""
    still = np.zeros(2)
    without, with_unit_input = simulator.acceleration_at(numbers)(still, still, np.array([0.0, 1.0]))
    return float(1.0 / abs(with_unit_input - without))


def rest_velocity(values: Mapping[str, float], step: float, inertia: float) -> float:
    """Velocity below which a companion's dry friction is viscous, so that one step cannot reverse it."""
    level = sum(abs(number) for name, number in values.items() if name.startswith(DRY_FRICTION_TERMS))
    level += sum(abs(float(table.forces[0])) for table in sort_effects(values).tables)
    return max(2.0 * step * level / inertia, 1e-6)


def _score(model: Model, dataset: Dataset, values: Mapping[str, float], horizon: float) -> Score:
    """Score a model with these values on the held-out data."""
    theta, index = start_values(model.parameters), index_of(model.parameters)
    for name, value in values.items():
        if name in index:
            theta[index[name]] = value
    return score(model, theta, dataset.test, noise_of(dataset.test), horizon)
