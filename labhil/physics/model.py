"""The interface between white-box models and identification.

A :class:`Model` simulates the windows of a record (``physics.record``) with any of its terms
(``physics.terms``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np

from labhil.errors import UnknownNameError, UsageError
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Parameter, Term
from labhil.signals import FloatArray


class Metric(StrEnum):
    """The error measure by which models of a rig are scored; fixed per rig kind."""

    WINDOWED_SIMULATION = "windowed_simulation"
    INVERSE_DYNAMICS = "inverse_dynamics"


class Model(Protocol):
    """White-box model of a rig: one simulation with every term, each of which vanishes at parameter zero.

    A vector ``theta`` holds a value for each of ``parameters``, in their order.
    """

    @property
    def kind(self) -> str:
        """Name of the rig kind."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states; names that end in ``_velocity`` are zero at rest."""
        ...

    @property
    def state_scale(self) -> FloatArray:
        """Typical error of a guessed initial state, (states,)."""
        ...

    @property
    def terms(self) -> Mapping[str, Term]:
        """All terms that the model may contain, by key."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters that may be estimated: those of the rig first, then those of all terms."""
        ...

    @property
    def fixed(self) -> Mapping[str, float]:
        """Values that the rig file states under [known], by name."""
        ...

    @property
    def unobservable_terms(self) -> Mapping[str, str]:
        """Terms that this recording cannot identify, each with the reason."""
        ...

    @property
    def metric(self) -> Metric:
        """The error measure by which the model is scored."""
        ...

    @property
    def fading_memory(self) -> bool:
        """Whether the effect of the initial state decays: windows may then be as long as the recording."""
        ...

    @property
    def horizon(self) -> float:
        """Scored horizon of the windowed simulation before a fit, s; sets the length of windows."""
        ...

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon of the windowed simulation at ``theta``, s; the one of the rig file if stated."""
        ...

    def prepare(self, record: Record) -> Record:
        """Make the record that is fitted and scored: filtered where accelerations are needed."""
        ...

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Guess the state at the first sample of each window from the measurement, (w, states)."""
        ...

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulate all windows from ``states`` (w, states); gives outputs (N, channels)."""
        ...

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Physical coordinates (positions, velocities, inputs) along the simulation, each (N,)."""
        ...

    @property
    def coordinate_units(self) -> Mapping[str, str]:
        """Units of the coordinates along which a mismatch is located; vectors are listed by name."""
        ...

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The coordinates that depend on ``theta`` at a given motion ``along``, each (N,).

        They change with effects of the input path, of a winding or of a load while the motion stays fixed.
        """
        ...

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Generalised force (or acceleration) of the model at coordinates, (N,) or (N, joints)."""
        ...

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Characteristic scales of a record, in units of which the starts of parameters are given."""
        ...


@runtime_checkable
class ReleasesInterpreter(Protocol):
    """A model whose compiled simulation lets other threads run, so that windows may share the cores."""

    releases_interpreter: bool


@runtime_checkable
class PartlyLinear(Model, Protocol):
    """A model without states that has exact derivatives by the parameters in which it is linear."""

    def regressor(self, theta: FloatArray, record: Record, free_keys: Sequence[str]) -> FloatArray:
        """Derivatives of :meth:`simulate` over a whole record by linear parameters, (N·c, P)."""
        ...


def unit_of(units: Mapping[str, str], name: str) -> str | None:
    """Unit of a coordinate (``actual_q_2`` has that of ``actual_q``); None if it is not listed."""
    return units.get(name, units.get(name.rpartition("_")[0]))


def index_of(parameters: Sequence[Parameter]) -> dict[str, int]:
    """Position of each parameter in a vector ``theta``, by key."""
    return {parameter.key: i for i, parameter in enumerate(parameters)}


def start_values(parameters: Sequence[Parameter]) -> FloatArray:
    """The vector ``theta`` at which terms vanish and the rig's own parameters have their first start."""
    return np.array([p.neutral if "." in p.name else p.starts[0] for p in parameters])


def starts_of(model: Model, terms: Sequence[Term], record: Record) -> list[dict[str, float]]:
    """Starting points of a fit of ``terms``: values by parameter key; in the first every level is zero."""
    scales = model.characteristic_scales(record)
    parameters = [p for term in terms for p in term.parameters]
    starts = {p.key: tuple(s * scales[p.of] ** p.power for s in p.starts) for p in parameters}
    neutral = {p.key: starts[p.key][0] if p.shape and starts[p.key] else p.neutral for p in parameters}
    count = max((len(values) for values in starts.values()), default=0)
    return [neutral] + [
        {name: values[min(i, len(values) - 1)] if values else 0.0 for name, values in starts.items()}
        for i in range(count)
    ]


def terms_named(model: Model, names: Sequence[str]) -> tuple[Term, ...]:
    """Look up terms by name or key, without duplicates; a name without joint stands for all joints.

    Raises:
        UnknownNameError: A term does not exist; the message lists those that do.
        UsageError: The recording cannot identify a term; the message has the reason.
    """
    by_name: dict[str, list[str]] = {}
    for key, term in model.terms.items():
        by_name.setdefault(term.name, []).append(key)
    keys: list[str] = []
    for name in names:
        if name not in model.terms and name not in by_name:
            if name in model.unobservable_terms:
                raise UsageError(f"{name}: this recording cannot show it: {model.unobservable_terms[name]}")
            raise UnknownNameError(f"term of {model.kind}", name, by_name)
        keys += [name] if name in model.terms else by_name[name]
    return tuple(model.terms[key] for key in dict.fromkeys(keys))
