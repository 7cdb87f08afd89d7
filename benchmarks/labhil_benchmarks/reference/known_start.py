"""The text's problem: one run over the whole recording from a state that is known, within stated bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labhil.physics.model import Metric, Model
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Parameter, Term
from labhil.signals import FloatArray


class KnownStart:
    """A model whose windows all begin in the same known state, so that nothing but parameters is estimated.

    Satisfies ``physics.model.Model``; ``state`` (states,) is that of the first sample. ``box`` maps keys of
    parameters to bounds that replace the model's own.
    """

    state_names: tuple[str, ...] = ()

    def __init__(
        self, model: Model, state: FloatArray, box: Mapping[str, tuple[float, float]] | None = None
    ) -> None:
        self._model = model
        self._state = np.asarray(state, dtype=np.float64)
        self.state_scale = np.empty(0)
        bounds = box or {}
        self.parameters: tuple[Parameter, ...] = tuple(
            replace(p, lower=bounds[p.key][0], upper=bounds[p.key][1]) if p.key in bounds else p
            for p in model.parameters
        )

    @property
    def kind(self) -> str:
        """Name of the rig kind."""
        return self._model.kind

    @property
    def terms(self) -> Mapping[str, Term]:
        """All terms that it may have, by name."""
        return self._model.terms

    @property
    def fixed(self) -> Mapping[str, float]:
        """Parameters that the rig file knows."""
        return self._model.fixed

    @property
    def unobservable_terms(self) -> Mapping[str, str]:
        """Terms that no recording of this rig can show, with the reason."""
        return self._model.unobservable_terms

    @property
    def metric(self) -> Metric:
        """The error by which it is judged."""
        return self._model.metric

    @property
    def fading_memory(self) -> bool:
        """Whether its state forgets how it began."""
        return self._model.fading_memory

    @property
    def horizon(self) -> float:
        """Scored horizon of the windowed simulation, s."""
        return self._model.horizon

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon of the windowed simulation, s."""
        return self._model.horizon_at(theta)

    def prepare(self, record: Record) -> Record:
        """What is fitted and scored."""
        return self._model.prepare(record)

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Nothing to guess, (w, 0)."""
        return np.empty((len(windows), 0))

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulated outputs of all windows, each from the known state, (N, channels)."""
        return self._model.simulate(theta, record, windows, self._known(windows))

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Physical coordinates along the simulation, each (N,)."""
        return self._model.coordinates(theta, record, windows, self._known(windows))

    @property
    def coordinate_units(self) -> Mapping[str, str]:
        """Units of the coordinates that people name."""
        return self._model.coordinate_units

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """How the motion ``along`` is driven, each (N,)."""
        return self._model.drive_coordinates(theta, record, windows, along)

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Generalised force that the model exerts at these coordinates, (N,)."""
        return self._model.generalised_force(theta, coordinates)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """What the starts of parameters are fractions of, in this record."""
        return self._model.characteristic_scales(record)

    def _known(self, windows: Windows) -> FloatArray:
        return np.tile(self._state, (len(windows), 1))
