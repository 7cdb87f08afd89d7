"""A first estimate of an arm whose masses nobody knows: which grouped parameters a record shows, how large.

It serves as start and scale of these parameters, and as the load in ``load_dependent_friction``: that
load then is the torque of one rigid body, and currents stay affine in what is estimated. A load that is
wrong by one per cent changes that friction, a few per cent of the torque itself, by one per cent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.kinds import JOINTS
from labhil.physics.arm.grouped import Grouped, NormalEquations, grouped, memory, significant
from labhil.physics.arm.links import Links
from labhil.physics.arm.motion import PreparedRecord
from labhil.physics.arm.rigid_body import upright
from labhil.physics.arm.view import View
from labhil.signals import FloatArray

LAWS = ("viscous_friction.coefficient", "coulomb_friction.level", "cubic_viscous_friction.coefficient")
PASSES = 2


@dataclass(frozen=True, slots=True)
class FirstEstimate:
    """Grouped parameters that a record shows, with values (P,) and standard errors (P,), SI."""

    grouped: Grouped
    values: FloatArray
    errors: FloatArray


def first_estimate(
    links: Links, seen: Sequence[tuple[PreparedRecord, View]], torque_constant: FloatArray
) -> FirstEstimate:
    """Least squares of the currents on the rigid body, friction and offsets of each joint.

    ``seen`` are recordings with their views; ``torque_constant`` (6,) N·m/A. Friction that grows with the
    load joins in once a load is known.
    """
    judged = np.concatenate([_judged(record) for record, _ in seen])
    outputs = np.concatenate([record.outputs for record, _ in seen])
    everything = grouped(links)
    loads = np.concatenate([view.rigid(upright(), 0.0)[:, :, list(everything.kept)] for _, view in seen])
    rigid = loads / torque_constant[None, :, None]
    others = _joint_columns(seen, None, torque_constant)
    columns = np.concatenate([rigid, others], axis=2)
    own = len(everything.kept)
    values = np.zeros(own)
    chosen = list(range(own))
    for _ in range(PASSES):
        equations = NormalEquations.of(columns, outputs, judged)
        found, _ = equations.solved(list(range(columns.shape[2])))
        inflation = memory((outputs - columns @ found) * judged)
        chosen = significant(equations, own, inflation)
        kept = chosen + list(range(own, columns.shape[2]))
        found, covariance = equations.solved(kept)
        values = found[: len(chosen)]
        inertial = everything.only(chosen).embedded(values)
        columns = np.concatenate([rigid, _joint_columns(seen, inertial, torque_constant)], axis=2)
    errors = np.sqrt(inflation * np.maximum(np.diag(covariance), 0.0))[: len(chosen)]
    return FirstEstimate(everything.only(chosen), values, errors)


def _judged(record: PreparedRecord) -> np.ndarray:
    """Which samples of which joints (n, 6) count."""
    motion = record.motion
    return np.ones(record.outputs.shape, dtype=bool) if motion is None else motion.judged[record.places]


def _joint_columns(
    seen: Sequence[tuple[PreparedRecord, View]], inertial: FloatArray | None, torque_constant: FloatArray
) -> FloatArray:
    """Friction and offset of each joint (n, 6, k): a joint's columns are zero for all others."""
    views = [view for _, view in seen]
    blocks = []
    for joint in range(JOINTS):
        own = [
            np.concatenate([view.law(joint, name, 0.0, 0.0, 0.0) for view in views]) / torque_constant[joint]
            for name in LAWS
        ]
        if inertial is not None:
            loads = [view.load(joint, 0.0, inertial, upright(), 0.0) for view in views]
            own.append(np.concatenate(loads) / torque_constant[joint])
        own.append(np.ones(len(own[0])))
        block = np.zeros((len(own[0]), JOINTS, len(own)))
        block[:, joint] = np.column_stack(own)
        blocks.append(block)
    return np.concatenate(blocks, axis=2)
