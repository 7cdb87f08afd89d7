"""An axis as inverse dynamics fits it: the force that a model needs for the measured motion.

M·ẍ + friction − other forces = gain·drive, both sides behind one low-pass (see ``physics.drive_balance``).
Nothing is simulated, so errors of the force do not add up along the way. What enters by the way in or by the
sensor is not offered: it looks the same as the force. Scores stay those of the axis itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from labhil.physics.axis import AxisModel
from labhil.physics.drive_balance import DriveMotion
from labhil.physics.driven import effective
from labhil.physics.model import Metric, Record, Windows
from labhil.physics.terms import CharacteristicScale, Enters, Term
from labhil.signals import FloatArray, Hold

AT_REST = ("static_friction",)
UNSEEN = "inverse dynamics sees forces on what moves; fit by simulation"


@dataclass(frozen=True, slots=True)
class ForceRecord(Record):
    """The judged places of the record ``whole``, its drive as the output, and the ``motion`` behind it."""

    motion: DriveMotion | None = field(default=None, compare=False)
    whole: Record | None = field(default=None, compare=False)


class AxisInverse:
    """The axis ``inner`` by inverse dynamics (satisfies ``physics.model.Model``).

    Its vector is the inner model's; its output is the recorded drive: a force in N, or a voltage in V.
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
            if term.enters is Enters.FORCE and key not in AT_REST
        }
        hidden = {key: UNSEEN for key in inner.terms if key not in self.terms}
        self.unobservable_terms: Mapping[str, str] = {**inner.unobservable_terms, **hidden}

    def horizon_at(self, theta: FloatArray) -> float:
        """The inner model's, s."""
        return self.inner.horizon_at(theta)

    def prepare(self, record: Record) -> ForceRecord:
        """The filtered drive at the judged places; RecordingError when hardly anything moves."""
        if isinstance(record, ForceRecord):
            return record
        motion = DriveMotion.of(record, self.inner.cut_off)
        rows, drive = motion.rows, motion.drive(*effective(record, 0, lambda name: 0.0))
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
        """There are none: (w, 0)."""
        return np.empty((len(windows), 0))

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """The drive that the motion needs, (N, 1), in N or V; of a record that was prepared."""
        assert isinstance(record, ForceRecord)
        assert record.motion is not None
        assert record.whole is not None
        force = self.inner.needed(theta, record.whole, record.motion)
        return (record.motion.at_judged(force) / self.inner.gain(theta))[windows.rows, None]

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """The measured position and velocity, and the drive that they need."""
        needed = self.simulate(theta, record, windows, states)[:, 0]
        x, v, _ = record.inputs[windows.rows].T
        return {"position": x, "axis_velocity": v, "acting_drive": needed}

    def driven(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The recorded drive, whatever the motion."""
        return {"acting_drive": record.outputs[windows.rows, 0]}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """The inner model's force on the moving mass, N."""
        return self.inner.generalised_force(theta, coordinates)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """The inner model's, of the record as it was measured."""
        return self.inner.characteristic_scales(
            record.whole or record if isinstance(record, ForceRecord) else record
        )
