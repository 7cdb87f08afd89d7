"""First estimate of the grouped inertial parameters of an arm of unknown masses, by linear least squares.

It gives starts and scales of these parameters, and the load in ``load_dependent_friction``. With a fixed load
the currents stay affine in the estimated parameters. A load error of one per cent changes that friction,
itself a few per cent of the torque, by one per cent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.physics.arm.chain import Chain
from labhil.physics.arm.grouped import (
    Grouped,
    NormalEquations,
    group_parameters,
    select_significant,
    variance_inflation,
)
from labhil.physics.arm.joint_laws import BUILT_IN
from labhil.physics.arm.motion import PreparedRecord
from labhil.physics.arm.rigid_body import gravity_in_base
from labhil.physics.arm.view import View
from labhil.signals import FloatArray

LAWS = ("viscous_friction.coefficient", "coulomb_friction.level", "cubic_viscous_friction.coefficient")


@dataclass(frozen=True, slots=True)
class FirstEstimate:
    """Grouped parameters that a record identifies, with values (P,) and standard errors (P,), SI.

    ``begin`` are the prior inertial parameters; those that a record does not identify keep their prior value.
    """

    grouped: Grouped
    values: FloatArray
    errors: FloatArray
    begin: FloatArray

    @property
    def prior_values(self) -> FloatArray:
        """Prior values of the grouped parameters, (P,)."""
        return np.asarray(self.grouped.shares @ self.begin)

    def inertial(self, values: FloatArray) -> FloatArray:
        """All inertial parameters (60,) for values (P,) of the grouped ones."""
        return self.begin + self.grouped.embed(values - self.prior_values)


def first_estimate(
    links: Chain,
    record: PreparedRecord,
    motion_view: View,
    torque_constant: FloatArray,
    laws: Sequence[str] = LAWS,
    *,
    passes: int = 2,
) -> FirstEstimate:
    """Estimate grouped parameters by least squares of the currents on rigid body, friction and offsets.

    Load-dependent friction is included from the second pass on, when a load is known.

    Args:
        links: The rigid bodies.
        record: A prepared record of one recording.
        motion_view: The view of its motion.
        torque_constant: Torque constants, (6,), N·m/A.
        laws: Friction laws of the joints that are fitted as well.
        passes: Number of passes.

    Returns:
        The estimate.
    """
    motion = record.motion
    judged = motion.judged[record.places] if motion is not None else np.ones(record.outputs.shape, dtype=bool)
    candidates = group_parameters(links)
    full = motion_view.rigid(gravity_in_base(), 0.0)
    measured = record.outputs - full @ links.begin / torque_constant
    rigid = full[:, :, list(candidates.kept)] / torque_constant[None, :, None]
    others = _joint_columns(motion_view, None, torque_constant, laws)
    columns = np.concatenate([rigid, others], axis=2)
    count = len(candidates.kept)
    values = np.zeros(count)
    chosen = list(range(count))
    for _ in range(passes):
        equations = NormalEquations.of(columns, measured, judged)
        estimate, _ = equations.solve(list(range(columns.shape[2])))
        inflation = variance_inflation((measured - columns @ estimate) * judged)
        chosen = select_significant(equations, count, inflation)
        kept = chosen + list(range(count, columns.shape[2]))
        estimate, covariance = equations.solve(kept)
        values = estimate[: len(chosen)]
        inertial = links.begin + candidates.only(chosen).embed(values)
        others = _joint_columns(motion_view, inertial, torque_constant, laws)
        columns = np.concatenate([rigid, others], axis=2)
    errors = np.sqrt(inflation * np.maximum(np.diag(covariance), 0.0))[: len(chosen)]
    shown = candidates.only(chosen)
    return FirstEstimate(shown, values + shown.shares @ links.begin, errors, links.begin)


def combine_estimates(links: Chain, estimates: Sequence[FirstEstimate]) -> FirstEstimate:
    """Combine the estimates of several recordings, which may differ in payload.

    A parameter that any recording identifies is included, with the value of the smallest standard error.
    """
    known: dict[int, tuple[float, float]] = {}
    for estimate in estimates:
        for column, value, error in zip(estimate.grouped.kept, estimate.values, estimate.errors, strict=True):
            if column not in known or error < known[column][1]:
                known[column] = (float(value), float(error))
    candidates = group_parameters(links)
    chosen = [i for i, column in enumerate(candidates.kept) if column in known]
    values, errors = zip(*(known[candidates.kept[i]] for i in chosen), strict=True) if chosen else ((), ())
    return FirstEstimate(candidates.only(chosen), np.array(values), np.array(errors), links.begin)


def _joint_columns(
    view: View, inertial: FloatArray | None, torque_constant: FloatArray, laws: Sequence[str]
) -> FloatArray:
    """Columns of friction and offset of each joint, (n, 6, k), zero for all other joints."""
    blocks = []
    for joint in range(len(torque_constant)):
        columns = [
            view.law(joint, name, BUILT_IN[name], 0.0, 0.0, 0.0) / torque_constant[joint] for name in laws
        ]
        if inertial is not None:
            columns.append(view.load(joint, 0.0, inertial, gravity_in_base(), 0.0) / torque_constant[joint])
        columns.append(np.ones(len(columns[0])))
        block = np.zeros((len(columns[0]), len(torque_constant), len(columns)))
        block[:, joint] = np.column_stack(columns)
        blocks.append(block)
    return np.concatenate(blocks, axis=2)
