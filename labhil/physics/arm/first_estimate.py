"""A first estimate of an arm whose masses nobody knows: which grouped parameters a record shows, how large.

It serves as start and scale of these parameters, and as the load in ``load_dependent_friction``: that
load then is the torque of one rigid body, and currents stay affine in what is estimated. A load that is
wrong by one per cent changes that friction, a few per cent of the torque itself, by one per cent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.physics.arm.chain import Chain
from labhil.physics.arm.grouped import Grouped, NormalEquations, grouped, memory, significant
from labhil.physics.arm.joint_laws import BUILT_IN
from labhil.physics.arm.motion import PreparedRecord
from labhil.physics.arm.rigid_body import upright
from labhil.physics.arm.view import View
from labhil.signals import FloatArray

LAWS = ("viscous_friction.coefficient", "coulomb_friction.level", "cubic_viscous_friction.coefficient")
PASSES = 2


@dataclass(frozen=True, slots=True)
class FirstEstimate:
    """Grouped parameters that a record shows, with values (P,) and standard errors (P,), SI.

    ``begin`` are inertial parameters that the estimate departs from: what a record does not show stays.
    """

    grouped: Grouped
    values: FloatArray
    errors: FloatArray
    begin: FloatArray

    @property
    def begun(self) -> FloatArray:
        """What the grouped parameters are before anything is estimated, (P,)."""
        return np.asarray(self.grouped.shares @ self.begin)

    def inertial(self, values: FloatArray) -> FloatArray:
        """All inertial parameters with these values (P,) of the grouped ones."""
        return self.begin + self.grouped.embed(values - self.begun)


def first_estimate(
    links: Chain,
    record: PreparedRecord,
    motion_view: View,
    torque_constant: FloatArray,
    laws: Sequence[str] = LAWS,
) -> FirstEstimate:
    """Least squares of the currents on the rigid body, friction and offsets of each joint.

    ``torque_constant`` (6,) N·m/A. Friction that grows with the load joins in once a load is known. What acts
    just as one of the joints' ``laws`` is left to that.
    """
    motion = record.motion
    judged = motion.judged[record.places] if motion is not None else np.ones(record.outputs.shape, dtype=bool)
    candidates = grouped(links)
    full = motion_view.rigid(upright(), 0.0)
    measured = record.outputs - full @ links.begin / torque_constant
    rigid = full[:, :, list(candidates.kept)] / torque_constant[None, :, None]
    others = _joint_columns(motion_view, None, torque_constant, laws)
    columns = np.concatenate([rigid, others], axis=2)
    count = len(candidates.kept)
    values = np.zeros(count)
    chosen = list(range(count))
    for _ in range(PASSES):
        equations = NormalEquations.of(columns, measured, judged)
        estimate, _ = equations.solve(list(range(columns.shape[2])))
        inflation = memory((measured - columns @ estimate) * judged)
        chosen = significant(equations, count, inflation)
        kept = chosen + list(range(count, columns.shape[2]))
        estimate, covariance = equations.solve(kept)
        values = estimate[: len(chosen)]
        inertial = links.begin + candidates.only(chosen).embed(values)
        others = _joint_columns(motion_view, inertial, torque_constant, laws)
        columns = np.concatenate([rigid, others], axis=2)
    errors = np.sqrt(inflation * np.maximum(np.diag(covariance), 0.0))[: len(chosen)]
    shown = candidates.only(chosen)
    return FirstEstimate(shown, values + shown.shares @ links.begin, errors, links.begin)


def best_of(links: Chain, estimates: Sequence[FirstEstimate]) -> FirstEstimate:
    """What several recordings show, each by itself: they may differ in what the arm carries.

    A parameter that one of them shows is included, with the value of the recording that knows it best.
    """
    known: dict[int, tuple[float, float]] = {}
    for estimate in estimates:
        for column, value, error in zip(estimate.grouped.kept, estimate.values, estimate.errors, strict=True):
            if column not in known or error < known[column][1]:
                known[column] = (float(value), float(error))
    candidates = grouped(links)
    chosen = [i for i, column in enumerate(candidates.kept) if column in known]
    values, errors = zip(*(known[candidates.kept[i]] for i in chosen), strict=True) if chosen else ((), ())
    return FirstEstimate(candidates.only(chosen), np.array(values), np.array(errors), links.begin)


def _joint_columns(
    view: View, inertial: FloatArray | None, torque_constant: FloatArray, laws: Sequence[str]
) -> FloatArray:
    """Friction and offset of each joint (n, 6, k): a joint's columns are zero for all others."""
    blocks = []
    for joint in range(len(torque_constant)):
        columns = [
            view.law(joint, name, BUILT_IN[name], 0.0, 0.0, 0.0) / torque_constant[joint] for name in laws
        ]
        if inertial is not None:
            columns.append(view.load(joint, 0.0, inertial, upright(), 0.0) / torque_constant[joint])
        columns.append(np.ones(len(columns[0])))
        block = np.zeros((len(columns[0]), len(torque_constant), len(columns)))
        block[:, joint] = np.column_stack(columns)
        blocks.append(block)
    return np.concatenate(blocks, axis=2)
