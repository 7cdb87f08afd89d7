"""A model with an additional free-form force: a spline of one coordinate with coefficients as parameters.

``diagnose.curve`` estimates it; ``saved_curve`` applies an estimated curve to other recordings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.spline import Spline
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, ExtraForce, MovedPart, along_positive
from labhil.physics.model import Metric, Model, PartlyLinear, unit_of
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Enters, Parameter, Term
from labhil.signals import FloatArray

UNMODELLED_FORCE = "unmodelled_force"
"""Name of the term in results."""

GRID_POINTS = 513
"""Points at which a kernel tabulates the spline; it interpolates linearly between them."""

COEFFICIENT_STEP = 1e-2
"""Step, in scales, of differences by coefficients: smaller ones vanish in rounding where motion stops."""

MAX_KNOT_SHARE_PER_STEP = 0.5
"""Share of the smallest distance between knots that one step of a simulation may pass."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """The argument of a force curve.

    Attributes:
        name: Of the coordinate.
        unit: Of the coordinate.
        acts: How the curve enters as a force.
        part: The moving part that it acts on.
    """

    name: str
    unit: str
    acts: CurveArgument
    part: MovedPart

    @property
    def period(self) -> float:
        """Period of a position that repeats, such as an angle; 0 for other coordinates."""
        return self.part.turn if self.name == self.part.position else 0.0

    def add_force(
        self, generalised_force: FloatArray, curve: FloatArray, coordinates: Mapping[str, FloatArray]
    ) -> FloatArray:
        """Add the force of a curve to a model's generalised force.

        Args:
            generalised_force: (N,), or (N, joints) of an arm, whose torques are those of its drives.
            curve: (N,) values of the curve.
            coordinates: The model's coordinates, each (N,).

        Returns:
            The sum, in the shape of ``generalised_force``.
        """
        velocity = coordinates[self.part.velocity]
        force = along_positive(self.acts, curve, velocity, np.sign(velocity))
        if self.part.joint is None:
            return np.asarray(generalised_force + force)
        # the drives of an arm have to exert the opposite torque
        torques = generalised_force.copy()
        torques[:, self.part.joint] -= force
        return torques

    def values(self, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Values (N,) of the argument for a model's coordinates, each (N,)."""
        values = coordinates[self.name]
        if self.acts is CurveArgument.SPEED_AGAINST:
            return np.abs(values)
        return np.mod(values, self.period) if self.period else values

    def force(self, grid: FloatArray, values: FloatArray, width: float) -> ExtraForce:
        """Make the force that a model applies.

        Args:
            grid: (m,) evenly spaced values of the coordinate.
            values: (m,) of the curve there.
            width: Largest change of the coordinate in one step of a simulation.
        """
        joint = self.part.joint
        return ExtraForce(self.acts, grid, values, width, turn=self.period, of=self.name, joint=joint)

    def values_in_record(self, record: Record) -> FloatArray:
        """Values (n,) along a record of a coordinate that is an input, an input's rate or time."""
        if self.name in record.input_names:
            return record.inputs[:, record.input_names.index(self.name)]
        if self.name.removesuffix("_rate") in record.input_names:
            column = record.input_names.index(self.name.removesuffix("_rate"))
            return np.concatenate([np.gradient(r.inputs[:, column], r.t) for r in record.recordings()])
        return record.t if self.name == "time" else record.auxiliary[self.name]


class ExtendedModel:
    """A model with a force that is a spline of one coordinate (satisfies ``physics.model.Model``).

    Its parameters are those of the inner model, followed by the spline's coefficients. The methods are those
    of ``Model``.

    Args:
        inner: The model without the force.
        coordinate: What the force is a function of.
        spline: Its basis functions.
        size: Typical value of the force, which scales the coefficients.
    """

    def __init__(self, inner: AcceptsExtraForce, coordinate: Coordinate, spline: Spline, size: float) -> None:
        self.inner = inner
        self.coordinate = coordinate
        self.spline = spline
        self.kind = inner.kind
        self.state_names = inner.state_names
        self.state_scale = inner.state_scale
        self.fixed = inner.fixed
        self.unobservable_terms = inner.unobservable_terms
        self.metric: Metric = inner.metric
        self.fading_memory = inner.fading_memory
        self.horizon = inner.horizon
        self.coordinate_units = inner.coordinate_units
        joint = coordinate.part.joint
        speed = unit_of(inner.coordinate_units, coordinate.part.velocity)
        per = f"/({speed})" if coordinate.acts is CurveArgument.DAMPING else ""
        unit = inner.force_unit + per
        self.coefficients = tuple(
            Parameter(f"{UNMODELLED_FORCE}.coefficient_{k}", unit, size, step=COEFFICIENT_STEP, joint=joint)
            for k in range(spline.count)
        )
        forward = coordinate.acts in (CurveArgument.TIME, CurveArgument.POSITION, CurveArgument.VELOCITY)
        direction, enters = "" if forward else " against the motion", coordinate.part.enters
        what = "difference" if enters is Enters.DIFFERENCE else "force"
        term = Term(
            UNMODELLED_FORCE, enters,
            f"a {what} along {coordinate.name}{direction} that no named effect explains",
            f"F = f({coordinate.name})", "estimated: a penalised spline (Eilers and Marx 1996)",
            f"motion over the whole range of {coordinate.name}", self.coefficients, joint=joint,
        )  # fmt: skip
        self.terms: Mapping[str, Term] = {**inner.terms, term.key: term}
        self.parameters = (*inner.parameters, *self.coefficients)

    def split(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Split a parameter vector into that of the inner model and the spline's coefficients (K,)."""
        return theta[: -self.spline.count], theta[-self.spline.count :]

    def horizon_at(self, theta: FloatArray) -> float:
        """The inner model's horizon, s."""
        return self.inner.horizon_at(self.split(theta)[0])

    def prepare(self, record: Record) -> Record:
        """The record as the inner model prepares it."""
        return self.inner.prepare(record)

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """The inner model's initial states, (w, states)."""
        return self.inner.initial_states(record, windows)

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulated outputs of all windows, (N, channels)."""
        inner_theta, coefficients = self.split(theta)
        return self._with_force(coefficients, record).simulate(inner_theta, record, windows, states)

    def regressor(self, theta: FloatArray, record: Record, free_keys: Sequence[str]) -> FloatArray:
        """Slopes by parameters that the inner model is linear in, with the force applied."""
        inner_theta, coefficients = self.split(theta)
        inner = self._with_force(coefficients, record)
        assert isinstance(inner, PartlyLinear)
        return inner.regressor(inner_theta, record, free_keys)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Coordinates along the simulation with the force applied, each (N,)."""
        inner_theta, coefficients = self.split(theta)
        return self._with_force(coefficients, record).coordinates(inner_theta, record, windows, states)

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The inner model's driven coordinates."""
        return self.inner.drive_coordinates(self.split(theta)[0], record, windows, along)

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """The inner model's generalised force plus the curve's, (N,) or (N, joints)."""
        inner_theta, coefficients = self.split(theta)
        generalised_force = self.inner.generalised_force(inner_theta, coordinates)
        if self.coordinate.name not in coordinates:
            return generalised_force
        curve = self.spline.design(self.coordinate.values(coordinates)) @ coefficients
        return self.coordinate.add_force(generalised_force, curve, coordinates)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """The inner model's characteristic scales."""
        return self.inner.characteristic_scales(record)

    def _with_force(self, coefficients: FloatArray, record: Record) -> Model:
        """The inner model with the force of these coefficients."""
        spline = self.spline
        grid = np.linspace(spline.low, spline.high, GRID_POINTS)
        force = self.coordinate.force(grid, grid, MAX_KNOT_SHARE_PER_STEP * spline.narrowest)
        if force.acts is CurveArgument.TIME:
            course = spline.design(self.coordinate.values_in_record(record)) @ coefficients
            return self.inner.with_force(replace(force, course=course))
        return self.inner.with_force(replace(force, values=spline.on(GRID_POINTS) @ coefficients))
