"""Evaluate a repaired arm's file by MuJoCo's own inverse dynamics along a recorded motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from labhil.extras import load_optional
from labhil.physics.arm.motion import PreparedRecord
from labhil.physics.record import Record, Windows
from labhil.rig import RigFile
from labhil.signals import FloatArray
from labhil.simulators.arm import ArmFileModel, ArmSimulator
from labhil.simulators.arm_file import without_contacts
from labhil.simulators.mechanism import PURPOSE
from labhil.simulators.urdf_patches import stiffen_model_friction


class Companion(Protocol):
    """The functions of the Python file that accompanies an arm's file."""

    Friction: Callable[[], Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]]
    measured: Callable[[FloatArray], FloatArray]
    ARMATURE: list[float]


class ArmFileRun(ArmFileModel):
    """The file with its companion as they are; nothing is fitted.

    Friction passes the filter of the measured torques, as everywhere in inverse dynamics.

    Args:
        simulator: The arm.
        rig: The rig file.
        record: The recording.
        companion: Functions of the companion.
        cut_off: Cut-off frequency of the filter, Hz.
        firm: Whether dry friction is made as firm as the time step allows.
    """

    def __init__(
        self,
        simulator: ArmSimulator,
        rig: RigFile,
        record: Record,
        companion: Companion,
        cut_off: float,
        *,
        firm: bool = False,
    ) -> None:
        super().__init__(simulator, rig, record)
        self.cut_off, self._companion, self._firm = cut_off, companion, firm
        self._measured: dict[int, FloatArray] = {}

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Return the outputs of the joints, (N, n).

        Where a joint rests, which is not scored, these are the measured outputs.
        """
        assert isinstance(record, PreparedRecord)
        parts = [self._outputs_of(recording) for recording in record.recordings()]
        return np.concatenate(parts)[windows.rows]

    def _outputs_of(self, record: Record) -> FloatArray:
        _, motion, rows = self._motion(record)
        measured = self._measured.get(id(motion))
        if measured is None:
            measured = self._measured[id(motion)] = self._companion.measured(self._drives(motion))
        return np.where(motion.judged[rows], measured[rows], record.outputs)

    def _drives(self, motion: Any) -> FloatArray:
        """Return the torques of the drives along a whole motion, (m, n)."""
        arm = self.simulator.arm
        links = inverse_dynamics(arm.rigid_body_model(), motion.q, motion.qd, motion.qdd)
        model = without_contacts(arm.model)
        if any(self._companion.ARMATURE):
            mujoco = load_optional("mujoco", PURPOSE)
            model.dof_armature[:] += self._companion.ARMATURE
            mujoco.mj_setConst(model, mujoco.MjData(model))
        if self._firm:
            stiffen_model_friction(model, float(model.opt.timestep))
        total = inverse_dynamics(model, motion.q, motion.qd, motion.qdd)
        friction = self._companion.Friction()
        along = zip(motion.q, motion.qd, motion.qdd, links, strict=True)
        extra = np.array([friction(*sample) for sample in along])
        return np.asarray(links + motion.filtered(total - links + extra))


def inverse_dynamics(model: Any, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
    """Return MuJoCo's torques (m, n) for a motion (m, n)."""
    mujoco = load_optional("mujoco", PURPOSE)
    data, out = mujoco.MjData(model), np.empty_like(q)
    for row in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[row], qd[row], qdd[row]
        mujoco.mj_inverse(model, data)
        out[row] = data.qfrc_inverse
    return out
