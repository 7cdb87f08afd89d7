"""Which effects the ports of a simulator take, with scales of the size that a recording shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.physics.friction_terms import friction_terms, load_dependent_friction
from labhil.physics.model import Record
from labhil.physics.path_terms import input_terms, offset_term, output_terms
from labhil.physics.terms import TWO_WAVES, Enters, Parameter, Term
from labhil.signals import FloatArray

PERIODS = 1.0
"""Of the measured motion, in a scored horizon: what swings through its upper rest soon forgets its past."""

TYPICAL = 2.0
"""A horizon where there is no recording, s."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """What a recording says of the motion: typical force, speed, span of the position, inertia, horizon."""

    force: float = 1.0
    speed: float = 1.0
    span: float = 1.0
    inertia: float = 1.0
    horizon: float = TYPICAL

    @classmethod
    def of(cls, record: Record, velocity_column: int | None, inertia: float, gain: float) -> Sizes:
        """Sizes in SI units; ``gain`` is what a unit of the input accelerates."""
        place = velocity_column != 0
        speeds = np.concatenate([rates(each, velocity_column) for each in record.recordings()])
        speed = float(np.sqrt(np.mean(speeds**2))) or 1.0
        drive = abs(gain) * float(np.sqrt(np.mean(record.inputs[:, 0] ** 2)))
        bend = float(np.std(np.diff(speeds))) / (_stride(record) * record.period)
        acceleration = drive or bend or 1.0
        span = float(np.ptp(record.outputs[:, 0])) if place else speed
        motion = (
            2.0 * np.pi * (float(np.std(record.outputs[:, 0])) / speed if place else speed / acceleration)
        )
        horizon = min(max(PERIODS * motion, 40.0 * record.period), record.max_horizon)
        return cls(inertia * acceleration, speed, span or 1.0, inertia, horizon)


def _stride(record: Record) -> int:
    return max(1, int(0.02 / record.period))


def rates(record: Record, velocity_column: int | None) -> FloatArray:
    """Velocities (m,) of a recording: measured ones, or of the position over stretches."""
    stride = _stride(record)
    if velocity_column is not None:
        return record.outputs[::stride, velocity_column]
    return np.asarray(np.diff(record.outputs[::stride, 0]) / np.diff(record.t[::stride]))


def catalogue(
    s: Sizes, force: str, length: str, place: str, drive: str, channel: str, unit: str
) -> dict[str, Term]:
    """All terms: ``force`` and ``length`` are the units of the coordinate ``place``, ``drive`` of the input.

    ``channel`` is the first output, in ``unit``.
    """
    level = 0.1 * s.force
    terms = friction_terms(force, length, level, s.speed) + force_terms(s, force, length, place)
    terms += (load_dependent_friction("the drive's force"), *input_terms(drive))
    terms += (*output_terms(channel, unit, s.span), offset_term(channel, unit, 0.1 * s.span))
    return {term.key: term for term in terms}


def force_terms(s: Sizes, force: str, length: str, place: str) -> tuple[Term, ...]:
    """Forces at a coordinate beside friction, and more inertia."""
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
                    starts=(20.0 / s.span, 60.0 / s.span, 200.0 / s.span), shape=True, waves_over=place,
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
