"""White-box model of an axis for a fit by inverse dynamics.

M·ẍ + friction − other forces = gain·drive, both sides behind one low-pass (see ``physics.drive_balance``,
with M in kg, x in m, forces in N). Nothing is simulated, so force errors do not accumulate. Terms of the
input path and of the sensor are left out, since they cannot be separated from forces here. Scores stay those
of the axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from labhil.physics.axis import AxisModel
from labhil.physics.drive_balance import DriveMotion
from labhil.physics.driven import effective_input
from labhil.physics.model import Metric
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Enters, Term
from labhil.signals import FloatArray, Hold

TERMS_NEAR_REST = ("static_friction", "presliding_friction")
NOT_IN_INVERSE_DYNAMICS = "inverse dynamics shows only forces on the moving part; fit by simulation"


@dataclass(frozen=True, slots=True)
class ForceRecord(Record):
    """The compared samples of the record ``whole``, with the drive as output, and the ``motion``."""

    motion: DriveMotion | None = field(default=None, compare=False)
    whole: Record | None = field(default=None, compare=False)


class AxisInverse:
    """Inverse dynamics of the axis ``inner`` (implements ``physics.model.Model``).

    The parameter vector is that of the inner model; the output is the recorded drive, in N or V.
    """

    kind = "axis"
    metric = Metric.INVERSE_DYNAMICS
    state_names: tuple[str, ...] = ()
    state_scale = np.empty(0)
    fading_memory = True

    def __init__(self, inner: AxisModel) -> None:
        self.inner = inner
        self.parameters = inner.parameters
        self.fixed = inner.fixed
        self.horizon = inner.horizon
        self.coordinate_units: Mapping[str, str] = inner.coordinate_units
        self.terms: Mapping[str, Term] = {
            key: term
            for key, term in inner.terms.items()
            if term.enters is Enters.FORCE and key not in TERMS_NEAR_REST
        }
        unobservable = {key: NOT_IN_INVERSE_DYNAMICS for key in inner.terms if key not in self.terms}
        self.unobservable_terms: Mapping[str, str] = {**inner.unobservable_terms, **unobservable}

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon of the inner model, s."""
        return self.inner.horizon_at(theta)

    def prepare(self, record: Record) -> ForceRecord:
        """Filter the record and keep the compared samples; RecordingError if there is too little motion."""
        if isinstance(record, ForceRecord):
            return record
        motion = DriveMotion.of(record, self.inner.cut_off)
        rows, drive = motion.rows, motion.drive(*effective_input(record, 0, lambda name: 0.0))
        return ForceRecord(
            t=motion.t[rows],
            inputs=np.column_stack([motion.x[rows], motion.v[rows], motion.a[rows]]),
            outputs=drive[:, None],
            input_names=("position", "axis_velocity", "axis_acceleration"),
            output_names=record.input_names,
            output_units=("V" if self.inner.volts else "N",),
            input_holds=(Hold.LINEAR,) * 3,
            auxiliary={name: np.interp(motion.t[rows], record.t, x) for name, x in record.auxiliary.items()},
            motion=motion,
            whole=record,
        )

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Inverse dynamics has no states: (w, 0)."""
        return np.empty((len(windows), 0))

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Compute the drive that the motion of a prepared record needs, (N, 1), N or V."""
        assert isinstance(record, ForceRecord)
        assert record.motion is not None
        assert record.whole is not None
        force = self.inner.inverse_dynamics(theta, record.whole, record.motion)
        return (record.motion.filter_and_select(force) / self.inner.gain(theta))[windows.rows, None]

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Measured position and velocity, and the drive that they need, each (N,)."""
        needed = self.simulate(theta, record, windows, states)[:, 0]
        x, v, _ = record.inputs[windows.rows].T
        return {"position": x, "axis_velocity": v, "acting_drive": needed}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The recorded drive, which does not depend on the motion."""
        return {"acting_drive": record.outputs[windows.rows, 0]}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Force of the inner model on the moving mass, (N,), N."""
        return self.inner.generalised_force(theta, coordinates)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Characteristic scales of the inner model for the unfiltered record."""
        return self.inner.characteristic_scales(
            record.whole or record if isinstance(record, ForceRecord) else record
        )
