"""A repaired arm's file as MuJoCo itself has it: torques by ``mj_inverse`` along a recorded motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from labhil.extras import load_optional
from labhil.physics.arm.motion import PreparedRecord
from labhil.physics.model import Record, Windows
from labhil.rig import RigFile
from labhil.signals import FloatArray
from labhil.simulators.arm import ArmFileModel, ArmSimulator
from labhil.simulators.arm_file import without_touching
from labhil.simulators.mechanism import PURPOSE
from labhil.simulators.urdf_patches import firm_friction


class Companion(Protocol):
    """The functions of the Python file that stands beside an arm's file."""

    Friction: Callable[[], Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]]
    measured: Callable[[FloatArray], FloatArray]
    ARMATURE: list[float]


class ArmFileRun(ArmFileModel):
    """The model of which nothing is fitted: the file and what stands beside it, as they are.

    Friction passes the filter of the measured torques, as everywhere in inverse dynamics.
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
        """Outputs of the joints, (N, n); the measured one where a joint rests, which is not judged."""
        assert isinstance(record, PreparedRecord)
        parts = [self._of(recording) for recording in record.recordings()]
        return np.concatenate(parts)[windows.rows]

    def _of(self, record: Record) -> FloatArray:
        _, motion, rows = self._motion(record)
        measured = self._measured.get(id(motion))
        if measured is None:
            measured = self._measured[id(motion)] = self._companion.measured(self._drives(motion))
        return np.where(motion.judged[rows], measured[rows], record.outputs)

    def _drives(self, motion: Any) -> FloatArray:
        """Torques of the drives along a whole motion, (m, n)."""
        arm = self.simulator.arm
        links = inverse(arm.quiet(), motion.q, motion.qd, motion.qdd)
        model = without_touching(arm.model)
        if any(self._companion.ARMATURE):
            mujoco = load_optional("mujoco", PURPOSE)
            model.dof_armature[:] += self._companion.ARMATURE
            mujoco.mj_setConst(model, mujoco.MjData(model))
        if self._firm:
            firm_friction(model, float(model.opt.timestep))
        total = inverse(model, motion.q, motion.qd, motion.qdd)
        friction = self._companion.Friction()
        along = zip(motion.q, motion.qd, motion.qdd, links, strict=True)
        extra = np.array([friction(*sample) for sample in along])
        return np.asarray(links + motion.filtered(total - links + extra))


def inverse(model: Any, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
    """MuJoCo's torques (m, n) for a motion (m, n)."""
    mujoco = load_optional("mujoco", PURPOSE)
    data, out = mujoco.MjData(model), np.empty_like(q)
    for row in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[row], qd[row], qdd[row]
        mujoco.mj_inverse(model, data)
        out[row] = data.qfrc_inverse
    return out
