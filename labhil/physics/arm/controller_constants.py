"""Torque constants that the controller of an arm uses, from its planned torques and currents.

i*_j = (τ*_j + friction_j(q̇_j))/K_j + offset, with planned current i* (A), planned torque τ* (N·m), velocity
q̇ (rad/s) and torque constant K (N·m/A) of joint j. The controller computes its planned current by a friction
model of its own, so a regression gives K without a measurement. This is the manufacturer's calibration, which
the drive need not have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.physics.arm.grouped import variance_inflation
from labhil.physics.record import Record
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class ControllerConstants:
    """Torque constants ``value`` (6,) with standard errors ``error`` (6,), N·m/A, gear ratio included."""

    value: FloatArray
    error: FloatArray

    @property
    def relative_error(self) -> float:
        """Largest relative standard error of the joints."""
        return float(np.max(self.error / self.value))


def controller_constants(record: Record) -> ControllerConstants | None:
    """Estimate the torque constants of the controller.

    Args:
        record: A record with the auxiliary channels target_current and target_moment.

    Returns:
        The constants; None if a channel is missing or a joint does not identify its constant.
    """
    constants = [_of_joint(record, joint) for joint in range(record.outputs.shape[1])]
    known = [constant for constant in constants if constant is not None]
    if len(known) < len(constants):
        return None
    value, error = np.array(known).T
    return ControllerConstants(value, error)


def constant_notes(
    constants: ControllerConstants,
    stated: Sequence[float] | None,
    taken: bool,
    *,
    tolerance: float = 0.03,
) -> tuple[str, ...]:
    """Notes for the user on the controller's constants.

    Args:
        constants: Those of the controller.
        stated: Those of the rig file, if any.
        taken: Whether the controller's are used.
        tolerance: Relative difference within which stated constants agree with the controller's.

    Returns:
        Notes; none where both agree.
    """
    listing = ", ".join(f"{v:.4g} ± {e:.2g}" for v, e in zip(constants.value, constants.error, strict=True))
    if taken:
        return (
            f"Torque constants are the controller's, from its planned torques and currents: {listing} N·m/A.",
        )
    if stated is None or np.all(np.abs(constants.value / np.array(stated) - 1.0) < tolerance):
        return ()
    return (
        f"The controller plans with torque constants of {listing} N·m/A; [known] has others, with "
        "which masses and frictions grow. Without them, and without masses, the controller's are taken.",
    )


def _of_joint(
    record: Record,
    joint: int,
    *,
    min_velocity: float = 0.02,
    min_samples: int = 200,
    max_relative_error: float = 0.05,
    min_decorrelation: float = 1e-3,
) -> tuple[float, float] | None:
    """Torque constant of a joint and its standard error, N·m/A; None if it is not identified.

    Args:
        record: The record.
        joint: The joint, from 0.
        min_velocity: Least velocity whose sign is reliable, rad/s.
        min_samples: Least number of samples above that velocity.
        max_relative_error: Largest relative standard error of a known constant.
        min_decorrelation: Least 1 − ρ of the residuals, ρ their correlation at lag 1.
    """
    planned = [record.auxiliary.get(f"{name}_{joint}") for name in ("target_current", "target_moment")]
    if planned[0] is None or planned[1] is None:
        return None
    velocity = record.inputs[:, record.input_names.index(f"actual_qd_{joint}")]
    moving = np.abs(velocity) > min_velocity
    if np.count_nonzero(moving) < min_samples:
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
        variance_inflation(residuals, min_decorrelation)
        * residuals.var()
        * np.linalg.inv(columns.T @ columns)[0, 0]
    )
    error = float(np.sqrt(variance) / size[0])
    return (
        (1.0 / inverse, error / inverse**2)
        if inverse > 0.0 and error < max_relative_error * inverse
        else None
    )
