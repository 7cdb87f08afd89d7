"""What identification asks of a model: its parameters, its terms, and simulated windows of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from labhil.errors import UnknownNameError
from labhil.physics.terms import Parameter, Term, Yardstick
from labhil.signals import FloatArray, Hold, IntArray


@dataclass(frozen=True, slots=True)
class Record:
    """One recording as a model sees it.

    ``t`` (n,) s, increasing; ``inputs`` (n, inputs) and ``outputs`` (n, channels) in SI units;
    ``input_holds`` (inputs,) what each input does between samples; ``auxiliary`` holds other channels of
    the rig, each (n,), by column name; ``output_joints`` (channels,) the joint of each output, where it
    has one.
    """

    t: FloatArray
    inputs: FloatArray
    outputs: FloatArray
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_holds: tuple[Hold, ...] = (Hold.LINEAR,)
    auxiliary: Mapping[str, FloatArray] = field(default_factory=dict)
    output_joints: tuple[int | None, ...] = ()

    def __len__(self) -> int:
        return len(self.t)

    @property
    def period(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.t)))

    def channel(self, j: int) -> tuple[str, int | None]:
        """Signal and joint of output column ``j``."""
        joint = self.output_joints[j] if self.output_joints else None
        name = self.output_names[j]
        return (name if joint is None else name.removesuffix(f"_{joint}")), joint

    def part(self, first: int, last: int) -> Record:
        """The samples first … last − 1."""
        return replace(
            self,
            t=self.t[first:last],
            inputs=self.inputs[first:last],
            outputs=self.outputs[first:last],
            auxiliary={name: values[first:last] for name, values in self.auxiliary.items()},
        )


@dataclass(frozen=True, slots=True)
class Windows:
    """Stretches of a record that are simulated each from an initial state of its own.

    Window w covers the samples first[w] … last[w] − 1. All results are the rows of all windows, one
    after the other: ``rows`` (N,) are their sample numbers, ``owner`` (N,) the window of each.
    """

    first: IntArray
    last: IntArray
    rows: IntArray
    owner: IntArray

    def __len__(self) -> int:
        return len(self.first)

    @classmethod
    def of(cls, spans: Sequence[tuple[int, int]]) -> Windows:
        """Build from (first, last) pairs."""
        first = np.array([a for a, _ in spans], dtype=np.int64)
        last = np.array([b for _, b in spans], dtype=np.int64)
        if not len(first):
            return cls(first, last, first.copy(), first.copy())
        rows = np.concatenate([np.arange(a, b, dtype=np.int64) for a, b in spans])
        return cls(first, last, rows, np.repeat(np.arange(len(first), dtype=np.int64), last - first))


class Metric(StrEnum):
    """By which error a model is judged; pinned per rig."""

    WINDOWED_SIMULATION = "windowed_simulation"
    INVERSE_DYNAMICS = "inverse_dynamics"


class Model(Protocol):
    """A rig's white-box model: one simulation that knows every term, neutral at zero.

    A vector ``theta`` holds a value for each of ``parameters``, in their order.
    """

    @property
    def kind(self) -> str:
        """Name of the rig kind."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states; those that end in ``_velocity`` are zero at rest."""
        ...

    @property
    def state_scale(self) -> FloatArray:
        """Typical error of a guessed state, (states,)."""
        ...

    @property
    def terms(self) -> Mapping[str, Term]:
        """All terms that it may have, by name."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What may be estimated: the rig's own parameters first, then those of all terms."""
        ...

    @property
    def fixed(self) -> Mapping[str, float]:
        """Parameters that the rig file knows."""
        ...

    @property
    def never_seen(self) -> Mapping[str, str]:
        """Terms that no recording of this rig can show, with the reason."""
        ...

    @property
    def metric(self) -> Metric:
        """The error by which it is judged."""
        ...

    @property
    def forgets(self) -> bool:
        """Whether its state forgets how it began: windows may then be as long as the recording."""
        ...

    @property
    def horizon(self) -> float:
        """Scored horizon of the windowed simulation (s) before anything is fitted, to cut windows by."""
        ...

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon of the windowed simulation, s; the rig file's own where it states one."""
        ...

    def prepare(self, record: Record) -> Record:
        """What is fitted and scored: the record itself, or filtered where accelerations are needed."""
        ...

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Guess the state at the first sample of each window from the measurement alone, (w, states)."""
        ...

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulated outputs of all windows, (N, channels)."""
        ...

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Physical coordinates (positions, velocities, inputs) along the simulation, each (N,)."""
        ...

    @property
    def coordinate_units(self) -> Mapping[str, str]:
        """Units of those coordinates by which a person would say where a mismatch lives; a vector's by its
        name alone."""
        ...

    def driven(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Those of the coordinates that say how the motion ``along`` is driven, each (N,), by this ``theta``.

        What effects on the way in, of the winding or of a load change, with the motion as it is.
        """
        ...

    def effort(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Generalised force (or acceleration) that the model exerts there, (N,) or (N, joints)."""
        ...

    def yardsticks(self, record: Record) -> Mapping[Yardstick, float]:
        """What the starts of parameters are fractions of, in this record."""
        ...


def index_of(parameters: Sequence[Parameter]) -> dict[str, int]:
    """Where each parameter stands in a vector ``theta``, by key."""
    return {parameter.key: i for i, parameter in enumerate(parameters)}


def start_values(parameters: Sequence[Parameter]) -> FloatArray:
    """The vector at which every term vanishes and the rig's own parameters are at their first start."""
    return np.array([p.neutral if "." in p.name else p.starts[0] for p in parameters])


def starts_of(model: Model, terms: Sequence[Term], record: Record) -> list[dict[str, float]]:
    """Sets of values from which a fit of these terms may begin, the first with every level at zero."""
    measure = model.yardsticks(record)
    parameters = [p for term in terms for p in term.parameters]
    begun = {p.key: tuple(s * measure[p.of] ** p.power for s in p.starts) for p in parameters}
    neutral = {p.key: begun[p.key][0] if p.shape and begun[p.key] else p.neutral for p in parameters}
    count = max((len(values) for values in begun.values()), default=0)
    return [neutral] + [
        {name: values[min(i, len(values) - 1)] if values else 0.0 for name, values in begun.items()}
        for i in range(count)
    ]


def terms_named(model: Model, names: Sequence[str]) -> tuple[Term, ...]:
    """The terms of a model by name or key, duplicates removed; a name alone means all joints.

    UnknownNameError lists the terms that exist.
    """
    by_name: dict[str, list[str]] = {}
    for key, term in model.terms.items():
        by_name.setdefault(term.name, []).append(key)
    keys: list[str] = []
    for name in names:
        if name not in model.terms and name not in by_name:
            raise UnknownNameError(f"term of {model.kind}", name, by_name)
        keys += [name] if name in model.terms else by_name[name]
    return tuple(model.terms[key] for key in dict.fromkeys(keys))
