"""Torque constants as the controller of an arm has them: what current it plans for what torque.

i*_j = (τ*_j + friction_j(q̇))/K_j + offset. The controller computes its planned current from its planned
torque and a friction model of its own, so that both together give K where no one has measured it. It is the
manufacturer's calibration; whether the drive has that constant is not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.physics.arm.grouped import memory
from labhil.physics.model import Record
from labhil.signals import FloatArray

SLOWEST = 0.02
"""rad/s under which the sign of a velocity is not relied upon."""

FEWEST = 200
"""Samples that have to be left of a joint."""

POOREST = 0.05
"""Relative standard error from which a constant is not known."""


APART = 0.03
"""Relative difference from which stated constants are not the controller's."""

LEAST_INDEPENDENT = 1e-3
"""What planned currents of a slow controller leave is that slow, at most."""


@dataclass(frozen=True, slots=True)
class ControllerConstants:
    """Torque constants ``value`` (6,) with standard errors ``error`` (6,), N·m/A, gear ratio included."""

    value: FloatArray
    error: FloatArray

    @property
    def relative_error(self) -> float:
        """The largest of the six."""
        return float(np.max(self.error / self.value))


def controller_constants(record: Record) -> ControllerConstants | None:
    """Constants by planned torques and currents; None where these are not recorded, or show too little."""
    constants = [_of_joint(record, joint) for joint in range(record.outputs.shape[1])]
    known = [constant for constant in constants if constant is not None]
    if len(known) < len(constants):
        return None
    value, error = np.array(known).T
    return ControllerConstants(value, error)


def notes_on(constants: ControllerConstants, stated: Sequence[float] | None, taken: bool) -> tuple[str, ...]:
    """Notes for people on the controller's constants beside those that a rig file states."""
    listing = ", ".join(f"{v:.4g} ± {e:.2g}" for v, e in zip(constants.value, constants.error, strict=True))
    if taken:
        return (
            f"Torque constants are the controller's, from its planned torques and currents: {listing} N·m/A.",
        )
    if stated is None or np.all(np.abs(constants.value / np.array(stated) - 1.0) < APART):
        return ()
    return (
        f"The controller plans with torque constants of {listing} N·m/A; [known] has others, with "
        "which masses and frictions grow. Without them, and without masses, the controller's are taken.",
    )


def _of_joint(record: Record, joint: int) -> tuple[float, float] | None:
    planned = [record.auxiliary.get(f"{name}_{joint}") for name in ("target_current", "target_moment")]
    if planned[0] is None or planned[1] is None:
        return None
    velocity = record.inputs[:, record.input_names.index(f"actual_qd_{joint}")]
    moving = np.abs(velocity) > SLOWEST
    if np.count_nonzero(moving) < FEWEST:
        return None
    current, torque, v = planned[0][moving], planned[1][moving], velocity[moving]
    columns = np.column_stack([torque, v, np.sign(v), v * np.abs(v), v**3, np.ones_like(v)])
    size = np.linalg.norm(columns, axis=0)
    if not np.all(size > 0.0):
        return None
    columns /= size
    shares, _, rank, _ = np.linalg.lstsq(columns, current)
    if rank < columns.shape[1]:
        return None
    residuals = current - columns @ shares
    inverse = float(shares[0] / size[0])
    variance = (
        memory(residuals, LEAST_INDEPENDENT) * residuals.var() * np.linalg.inv(columns.T @ columns)[0, 0]
    )
    error = float(np.sqrt(variance) / size[0])
    return (1.0 / inverse, error / inverse**2) if inverse > 0.0 and error < POOREST * inverse else None
