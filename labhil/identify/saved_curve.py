"""A curve that a diagnosis estimated, kept as a part of a model: the same force on other recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.extended import Coordinate
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, ExtraForce, with_place
from labhil.physics.model import Metric, Model, Record, Windows
from labhil.physics.terms import CharacteristicScale
from labhil.signals import FloatArray

RESOLVED = 0.02
"""Share of the curve's range that one step of a simulation may pass."""


@dataclass(frozen=True, slots=True)
class SavedCurve:
    """A force with the values ``value`` (m,), in ``unit``, at the evenly spaced places ``x`` (m,).

    ``low`` … ``high`` (m,) is its pointwise 99 % band. Beyond its range it keeps its last value.
    """

    coordinate: Coordinate
    x: FloatArray
    value: FloatArray
    low: FloatArray
    high: FloatArray
    unit: str
    formula: str | None = None

    def at(self, places: FloatArray) -> FloatArray:
        """The curve at other places (N,)."""
        return np.interp(places, self.x, self.value)

    def force(self, record: Record) -> ExtraForce:
        """As a model takes it, on this record."""
        force = self.coordinate.force(self.x, self.value, RESOLVED * float(self.x[-1] - self.x[0]))
        if self.coordinate.acts is not CurveArgument.TIME:
            return force
        return replace(force, course=self.at(self.coordinate.of_record(record)))


class ModelUnderCurves:
    """A model under known forces (satisfies ``physics.model.Model``); all else is the inner one's.

    Of a single moving part one force, of an arm one or several on each joint.
    """

    def __init__(self, inner: AcceptsExtraForce, curves: Sequence[SavedCurve]) -> None:
        inner = with_place(inner, [curve.coordinate.name for curve in curves])
        self.inner = inner
        self.curves = tuple(curves)
        self.kind = inner.kind
        self.state_names = inner.state_names
        self.state_scale = inner.state_scale
        self.fixed = inner.fixed
        self.unobservable_terms = inner.unobservable_terms
        self.metric: Metric = inner.metric
        self.fading_memory = inner.fading_memory
        self.horizon = inner.horizon
        self.coordinate_units = inner.coordinate_units
        self.terms = inner.terms
        self.parameters = inner.parameters

    def horizon_at(self, theta: FloatArray) -> float:
        """The inner model's, s."""
        return self.inner.horizon_at(theta)

    def prepare(self, record: Record) -> Record:
        """As the inner model does."""
        return self.inner.prepare(record)

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """The inner model's, (w, states)."""
        return self.inner.initial_states(record, windows)

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulated outputs of all windows, (N, channels)."""
        return self._under(record).simulate(theta, record, windows, states)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Coordinates along the simulation under the forces, each (N,)."""
        return self._under(record).coordinates(theta, record, windows, states)

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The inner model's."""
        return self.inner.drive_coordinates(theta, record, windows, along)

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """The inner model's force and the curves', (N,) or (N, joints)."""
        generalised_force = self.inner.generalised_force(theta, coordinates)
        for curve in self.curves:
            if curve.coordinate.name in coordinates:
                values = curve.at(curve.coordinate.of(coordinates))
                generalised_force = curve.coordinate.beside(generalised_force, values, coordinates)
        return generalised_force

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """The inner model's."""
        return self.inner.characteristic_scales(record)

    def _under(self, record: Record) -> Model:
        return under(self.inner, self.curves, record)


def under(model: AcceptsExtraForce, curves: Sequence[SavedCurve], record: Record) -> AcceptsExtraForce:
    """The model under these curves on one record."""
    for curve in curves:
        model = model.with_force(curve.force(record))
    return model
