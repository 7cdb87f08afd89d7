"""A force curve that a diagnosis estimated and saved, applied to a model on other recordings.

``extended`` is the model in which such a curve is estimated; ``analysis.saved_curves`` reads and writes the
file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.extended import Coordinate
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, ExtraForce, with_place
from labhil.physics.model import Metric
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale
from labhil.signals import FloatArray

MAX_RANGE_SHARE_PER_STEP = 0.02
"""Share of the curve's range that one step of a simulation may pass."""


@dataclass(frozen=True, slots=True)
class SavedCurve:
    """A force as a tabulated function of a coordinate; beyond its range it keeps its last value.

    Attributes:
        coordinate: The argument.
        x: (m,) evenly spaced values of the coordinate.
        value: (m,) force there, in ``unit``.
        low: (m,) lower end of the pointwise 99 % band; ``high`` the upper end.
        unit: Of the force.
        formula: A law that fits the curve, as text; None where none does.
    """

    coordinate: Coordinate
    x: FloatArray
    value: FloatArray
    low: FloatArray
    high: FloatArray
    unit: str
    formula: str | None = None

    def at(self, places: FloatArray) -> FloatArray:
        """Interpolate the force at values (N,) of the coordinate."""
        return np.interp(places, self.x, self.value)

    def force(self, record: Record) -> ExtraForce:
        """Make the force that a model applies on this record."""
        width = MAX_RANGE_SHARE_PER_STEP * float(self.x[-1] - self.x[0])
        force = self.coordinate.force(self.x, self.value, width)
        if self.coordinate.acts is not CurveArgument.TIME:
            return force
        return replace(force, course=self.at(self.coordinate.values_in_record(record)))


class ModelUnderCurves:
    """A model with known forces applied (satisfies ``physics.model.Model``, whose methods it has).

    Args:
        inner: The model without them.
        curves: One force for a model with a single moving part; one or several on each joint of an arm.
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
        """The inner model's horizon, s."""
        return self.inner.horizon_at(theta)

    def prepare(self, record: Record) -> Record:
        """The record as the inner model prepares it."""
        return self.inner.prepare(record)

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """The inner model's initial states, (w, states)."""
        return self.inner.initial_states(record, windows)

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulated outputs of all windows, (N, channels)."""
        return apply_curves(self.inner, self.curves, record).simulate(theta, record, windows, states)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Coordinates along the simulation with the forces applied, each (N,)."""
        return apply_curves(self.inner, self.curves, record).coordinates(theta, record, windows, states)

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The inner model's driven coordinates."""
        return self.inner.drive_coordinates(theta, record, windows, along)

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """The inner model's generalised force plus the curves', (N,) or (N, joints)."""
        generalised_force = self.inner.generalised_force(theta, coordinates)
        for curve in self.curves:
            if curve.coordinate.name in coordinates:
                values = curve.at(curve.coordinate.values(coordinates))
                generalised_force = curve.coordinate.add_force(generalised_force, values, coordinates)
        return generalised_force

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """The inner model's characteristic scales."""
        return self.inner.characteristic_scales(record)


def apply_curves(model: AcceptsExtraForce, curves: Sequence[SavedCurve], record: Record) -> AcceptsExtraForce:
    """Apply force curves to a model for the simulation of one record."""
    for curve in curves:
        model = model.with_force(curve.force(record))
    return model
