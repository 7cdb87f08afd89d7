"""A model with one more force: a spline whose coefficients are parameters like all others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.spline import Spline
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, ExtraForce, MovedPart, along_positive
from labhil.physics.model import Metric, Model, PartlyLinear, Record, Windows, unit_of
from labhil.physics.terms import CharacteristicScale, Enters, Parameter, Term
from labhil.signals import FloatArray

NAME = "unmodelled_force"
NODES = 513
"""Places at which a kernel keeps the spline, straight in between."""

STEP = 1e-2
"""Difference, in scales, with which slopes by coefficients are taken: small ones drown where motion stops."""

RESOLVED = 0.5
"""Share of the narrowest stretch between knots that one step of a simulation may pass."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """What the force is a function of.

    ``name`` is the coordinate's, ``unit`` its unit; ``acts`` says which way, ``part`` on what.
    """

    name: str
    unit: str
    acts: CurveArgument
    part: MovedPart

    @property
    def turn(self) -> float:
        """Period of a position that repeats; 0 of anything else."""
        return self.part.turn if self.name == self.part.position else 0.0

    def beside(
        self, generalised_force: FloatArray, curve: FloatArray, coordinates: Mapping[str, FloatArray]
    ) -> FloatArray:
        """A model's ``generalised_force``, (N,) or (N, joints), with that of the curve's values (N,)."""
        velocity = coordinates[self.part.velocity]
        force = along_positive(self.acts, curve, velocity, np.sign(velocity))
        if self.part.joint is None:
            return np.asarray(generalised_force + force)
        # of an arm it is what the drives have to exert
        torques = generalised_force.copy()
        torques[:, self.part.joint] -= force
        return torques

    def of(self, along: Mapping[str, FloatArray]) -> FloatArray:
        """Its values where a model's coordinates are ``along``, (N,)."""
        values = along[self.name]
        if self.acts is CurveArgument.SPEED_AGAINST:
            return np.abs(values)
        return np.mod(values, self.turn) if self.turn else values

    def force(self, grid: FloatArray, values: FloatArray, width: float) -> ExtraForce:
        """As a model takes it: ``values`` (m,) at evenly spaced places ``grid`` (m,)."""
        joint = self.part.joint
        return ExtraForce(self.acts, grid, values, width, turn=self.turn, of=self.name, joint=joint)

    def of_record(self, record: Record) -> FloatArray:
        """Its values along a record, (n,), where it is an input, an input's rate or time."""
        if self.name in record.input_names:
            return record.inputs[:, record.input_names.index(self.name)]
        if self.name.removesuffix("_rate") in record.input_names:
            column = record.input_names.index(self.name.removesuffix("_rate"))
            return np.concatenate([np.gradient(r.inputs[:, column], r.t) for r in record.recordings()])
        return record.t if self.name == "time" else record.auxiliary[self.name]


class ExtendedModel:
    """A model under a force that is a spline of one coordinate (satisfies ``physics.model.Model``).

    Its parameters are those of ``inner`` and after them the spline's coefficients; all else is the inner
    model's. ``size`` is a typical value of the curve.
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
        self.coefficients = tuple(
            Parameter(f"{NAME}.coefficient_{k}", inner.force_unit + per, size, step=STEP, joint=joint)
            for k in range(spline.count)
        )
        forward = coordinate.acts in (CurveArgument.TIME, CurveArgument.POSITION, CurveArgument.VELOCITY)
        direction, enters = "" if forward else " against the motion", coordinate.part.enters
        what = "difference" if enters is Enters.DIFFERENCE else "force"
        term = Term(
            NAME, enters, f"a {what} along {coordinate.name}{direction} that no named effect explains",
            f"F = f({coordinate.name})", "estimated: a penalised spline (Eilers and Marx 1996)",
            f"motion over the whole range of {coordinate.name}", self.coefficients, joint=joint,
        )  # fmt: skip
        self.terms: Mapping[str, Term] = {**inner.terms, term.key: term}
        self.parameters = (*inner.parameters, *self.coefficients)

    def split(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The inner model's vector and the spline's coefficients (K,)."""
        return theta[: -self.spline.count], theta[-self.spline.count :]

    def horizon_at(self, theta: FloatArray) -> float:
        """The inner model's, s."""
        return self.inner.horizon_at(self.split(theta)[0])

    def prepare(self, record: Record) -> Record:
        """As the inner model does."""
        return self.inner.prepare(record)

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """The inner model's, (w, states)."""
        return self.inner.initial_states(record, windows)

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulated outputs of all windows, (N, channels)."""
        inner_theta, coefficients = self.split(theta)
        return self._under(coefficients, record).simulate(inner_theta, record, windows, states)

    def regressor(self, theta: FloatArray, record: Record, free_keys: Sequence[str]) -> FloatArray:
        """The inner model's slopes by parameters that it is linear in, under the force."""
        inner_theta, coefficients = self.split(theta)
        inner = self._under(coefficients, record)
        assert isinstance(inner, PartlyLinear)
        return inner.regressor(inner_theta, record, free_keys)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Coordinates along the simulation under the force, each (N,)."""
        inner_theta, coefficients = self.split(theta)
        return self._under(coefficients, record).coordinates(inner_theta, record, windows, states)

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The inner model's."""
        return self.inner.drive_coordinates(self.split(theta)[0], record, windows, along)

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """The inner model's force and the curve's, (N,)."""
        inner_theta, coefficients = self.split(theta)
        generalised_force = self.inner.generalised_force(inner_theta, coordinates)
        if self.coordinate.name not in coordinates:
            return generalised_force
        curve = self.spline.design(self.coordinate.of(coordinates)) @ coefficients
        return self.coordinate.beside(generalised_force, curve, coordinates)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """The inner model's."""
        return self.inner.characteristic_scales(record)

    def _under(self, coefficients: FloatArray, record: Record) -> Model:
        """The inner model under the force that these coefficients make of the record."""
        spline = self.spline
        grid = np.linspace(spline.low, spline.high, NODES)
        force = self.coordinate.force(grid, grid, RESOLVED * spline.narrowest)
        if force.acts is CurveArgument.TIME:
            course = spline.design(self.coordinate.of_record(record)) @ coefficients
            return self.inner.with_force(replace(force, course=course))
        return self.inner.with_force(replace(force, values=spline.on(NODES) @ coefficients))
