"""The terms of a simulator with one coordinate, with scales measured in a recording.

The same laws as for the built-in rigs (:mod:`labhil.physics.friction_terms`, ``path_terms``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from labhil.physics.friction_terms import friction_terms, load_dependent_friction
from labhil.physics.path_terms import input_terms, offset_term, output_terms
from labhil.physics.record import Record
from labhil.physics.terms import TWO_WAVES, Enters, Parameter, Term
from labhil.physics.warming import TEMPERATURE, warming_friction
from labhil.physics.weak_form import MassAndDrag, regress_mass_and_drag
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class Sizes:
    """Typical sizes of the motion in a recording, SI.

    Attributes:
        force: Generalised force.
        speed: Velocity, RMS.
        span: Range of the position; of the velocity where no position is measured.
        inertia: Inertia of the simulator.
        horizon: Length of a scored window, s.
        measured: Inertia and viscous friction by a regression, in units of the input.
    """

    force: float = 1.0
    speed: float = 1.0
    span: float = 1.0
    inertia: float = 1.0
    horizon: float = 2.0
    measured: MassAndDrag | None = None

    @classmethod
    def of(
        cls,
        record: Record,
        velocity_column: int | None,
        inertia: float,
        gain: float,
        *,
        periods: float = 1.0,
        time_constants: float = 3.0,
        min_samples: float = 40.0,
    ) -> Sizes:
        """Measure the scales in a recording.

        Args:
            record: The recording.
            velocity_column: Column of the measured velocity; None where the position alone is measured.
            inertia: Inertia of the simulator.
            gain: Acceleration per unit of the input.
            periods: Length of the horizon in periods of the measured motion. One: a pendulum that passes its
                upper rest soon forgets its past.
            time_constants: Longest horizon in time constants of inertia and viscous friction, after which an
                error of the velocity is forgotten.
            min_samples: Shortest horizon in sampling periods.

        Returns:
            The scales.
        """
        has_position = velocity_column != 0
        speeds = np.concatenate([velocities_of(part, velocity_column) for part in record.recordings()])
        speed = float(np.sqrt(np.mean(speeds**2))) or 1.0
        by_input = abs(gain) * float(np.sqrt(np.mean(record.inputs[:, 0] ** 2)))
        measured = float(np.std(np.diff(speeds))) / (_stride(record) * record.period)
        acceleration = by_input or measured or 1.0
        span = float(np.ptp(record.outputs[:, 0])) if has_position else speed
        period = (
            2.0
            * np.pi
            * (float(np.std(record.outputs[:, 0])) / speed if has_position else speed / acceleration)
        )
        recordings = record.recordings() if has_position else _with_positions(record)
        balance = regress_mass_and_drag(recordings, 1.0, 0.25 * period)
        memory = time_constants * _time_constant(balance)
        horizon = min(max(min(periods * period, memory), min_samples * record.period), record.max_horizon)
        return cls(inertia * acceleration, speed, span or 1.0, inertia, horizon, balance)


def _with_positions(record: Record) -> list[Record]:
    """Recordings of a velocity, integrated."""
    return [
        replace(part, outputs=cumulative_trapezoid(part.outputs, part.t, axis=0, initial=0.0))
        for part in record.recordings()
    ]


def _time_constant(measured: MassAndDrag) -> float:
    """Inertia over viscous friction, s; infinite where a recording shows none."""
    return measured.mass / measured.drag if measured.mass * measured.drag > 0.0 else np.inf


def _stride(record: Record) -> int:
    return max(1, int(0.02 / record.period))


def velocities_of(record: Record, velocity_column: int | None) -> FloatArray:
    """Take the velocities (m,) of a recording: measured, or as slopes of the position over 20 ms."""
    stride = _stride(record)
    if velocity_column is not None:
        return record.outputs[::stride, velocity_column]
    return np.asarray(np.diff(record.outputs[::stride, 0]) / np.diff(record.t[::stride]))


def catalogue(
    sizes: Sizes, force: str, length: str, position: str, drive: str, channel: str, unit: str
) -> dict[str, Term]:
    """Build all terms that a simulator with one coordinate can have.

    Args:
        scales: Typical sizes, from which starts and scales of the parameters follow.
        force: Unit of the generalised force.
        length: Unit of the coordinate.
        position: Name of the coordinate.
        drive: Unit of the input.
        channel: Name of the first output.
        unit: Unit of the first output.

    Returns:
        The terms by key.
    """
    level = 0.1 * sizes.force
    terms = friction_terms(force, length, level, sizes.speed) + force_terms(sizes, force, length, position)
    terms += (load_dependent_friction("the drive's force"), warming_friction("the mechanism", TEMPERATURE))
    terms += input_terms(drive)
    terms += (*output_terms(channel, unit, sizes.span), offset_term(channel, unit, 0.1 * sizes.span))
    return {term.key: term for term in terms}


def force_terms(s: Sizes, force: str, length: str, position: str) -> tuple[Term, ...]:
    """Build the terms that are forces at a coordinate, but friction; names as in `catalogue`."""
    level = 0.1 * s.force
    return (
        Term(
            "constant_force", Enters.FORCE, "a constant push (tilt, offset of the drive)", "F = F_0",
            "standard", "motion both ways", (Parameter("constant_force.force", force, level),),
        ),
        Term(
            "spring_force", Enters.FORCE, "a pull back towards zero in proportion to position", "F = −k·x",
            "Hooke", "motion over the whole range",
            (Parameter("spring_force.stiffness", f"{force}/{length}", level / s.span),),
        ),
        Term(
            "spring_hardening", Enters.FORCE, "a pull back towards zero that stiffens with position",
            "F = −k₃·x³", "Duffing", "motion over the whole range",
            (Parameter("spring_hardening.coefficient", f"{force}/{length}³", level / s.span**3),),
        ),
        Term(
            "cogging_torque", Enters.FORCE, "a force that repeats along the way (magnets, a screw's pitch)",
            "F = −a·sin kx − b·cos kx", "period of the drive", "slow motion",
            (
                Parameter("cogging_torque.sine", force, level, starts=(0.3 * level,)),
                Parameter("cogging_torque.cosine", force, level, starts=(0.3 * level,)),
                Parameter(
                    "cogging_torque.order", f"rad/{length}", 20.0 / s.span, TWO_WAVES / s.span, 2e3 / s.span,
                    starts=(20.0 / s.span, 60.0 / s.span, 200.0 / s.span), shape=True, waves_over=position,
                ),
            ),
        ),
        Term(
            "added_inertia", Enters.FORCE, "more inertia than the simulator has (a load)", "(M + m)·ẍ = …",
            "standard", "acceleration",
            (
                Parameter(
                    "added_inertia.inertia", f"{force}·s²/{length}", 0.1 * s.inertia, -0.5 * s.inertia
                ),
            ),
        ),
    )  # fmt: skip
