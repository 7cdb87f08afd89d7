"""Inverse dynamics of an axis: the drive force that the measured motion needs, and the one exerted.

The position passes a zero-phase low-pass at three times the cut-off and is differentiated twice. The force
that the model needs for that motion and the force of the drive both pass a low-pass at the cut-off (parallel
filtering: Gautier 1997; Janot, Gautier, Brunot 2019 on the benchmark EMPS). The first filter is wider so that
a reversal, at which dry friction jumps, stays in place. At rest dry friction takes any value up to its level,
so samples at rest, near the ends and near gaps are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from labhil.errors import RecordingError
from labhil.physics.arm.motion import MAX_GAP_IN_PERIODS, MIN_SAMPLES, ROWS_PER_CUT_OFF_PERIOD, LowPass
from labhil.physics.record import Record
from labhil.signals import FloatArray, IntArray

DEFAULT_CUT_OFF = 20.0
"""Cut-off where the rig file states none, Hz."""

POSITION_CUT_OFF_FACTOR = 3.0
"""Cut-off of the position over that of the forces."""


ROUNDING_SHARE = 64.0 * float(np.finfo(np.float64).eps)
"""Rounding error of a position as a share of its largest absolute value."""


@dataclass(frozen=True, slots=True, eq=False)
class DriveMotion:
    """The measured motion, evenly sampled and smooth enough for two derivatives.

    Attributes:
        t: Times, (n,), s.
        x: Position, (n,), m.
        v: Velocity, (n,), m/s.
        a: Acceleration, (n,), m/s².
        rows: Samples that are compared, (k,), about 2.5 per period of the cut-off.
        low_pass: The filter of the forces.
    """

    t: FloatArray
    x: FloatArray
    v: FloatArray
    a: FloatArray
    rows: IntArray
    low_pass: LowPass

    @classmethod
    def of(
        cls,
        record: Record,
        cut_off: float = DEFAULT_CUT_OFF,
        *,
        max_cut_off_share: float = 0.1,
        rest_speed_share: float = 0.01,
    ) -> DriveMotion:
        """Filter and differentiate the first output of a record.

        Args:
            record: The record.
            cut_off: Cut-off of the forces, Hz.
            max_cut_off_share: Highest cut-off over the sampling rate, with room for the wider low-pass.
            rest_speed_share: Speed below which the axis is at rest, over the RMS speed, where that lasts for
                longer than the reach of the filter.

        Returns:
            The motion.

        Raises:
            RecordingError: The record is too short, or there is too little motion.
        """
        period = record.period
        t = record.t[0] + period * np.arange(int((record.t[-1] - record.t[0]) / period + 1e-6) + 1)
        low_pass = LowPass(min(cut_off, max_cut_off_share / period), period)
        if len(t) < max(MIN_SAMPLES, 8 * low_pass.reach):
            raise RecordingError(f"too short for inverse dynamics: {len(t)} samples")
        x = _smoother(low_pass)(np.interp(t, record.t, record.outputs[:, 0]))
        v = np.gradient(x, period)
        rounding = ROUNDING_SHARE * float(np.abs(x).max()) / period
        rows = _judged_rows(
            record.t, t, np.abs(v) > max(rest_speed_share * float(np.sqrt(np.mean(v**2))), rounding), low_pass
        )
        if len(rows) < MIN_SAMPLES:
            raise RecordingError(
                f"too little motion for inverse dynamics: {len(rows)} places are left below "
                f"{low_pass.cut_off:g} Hz, at least {MIN_SAMPLES} are needed"
            )
        return cls(t, x, v, np.gradient(v, period), rows, low_pass)

    def filter_and_select(self, force: FloatArray) -> FloatArray:
        """Low-pass a force (n,) and take the samples that are compared, (k,)."""
        return self.low_pass(force)[self.rows]

    def drive(self, nodes: FloatArray, values: FloatArray) -> FloatArray:
        """Low-pass a drive that is linear between ``nodes`` (m,), s; gives the compared samples, (k,).

        A held drive jumps at the samples, where the mean of both sides is taken.
        """
        half = 0.5 * self.low_pass.period
        both = np.interp(self.t - half, nodes, values) + np.interp(self.t + half, nodes, values)
        return self.filter_and_select(0.5 * both)

    @property
    def noise(self) -> float:
        """RMS of the filtered acceleration for white noise of 1 m of the position, m/s²."""
        impulse = np.zeros(16 * self.low_pass.reach + 1)
        impulse[len(impulse) // 2] = 1.0
        smooth = _smoother(self.low_pass)(impulse)
        period = self.low_pass.period
        return float(np.linalg.norm(self.low_pass(np.gradient(np.gradient(smooth, period), period))))


@dataclass(frozen=True, slots=True)
class Balance:
    """Drive force that a motion needs and drive force exerted, low-pass filtered.

    Attributes:
        needed: Force that the motion needs, (k,), N.
        exerted: Force of the drive, (k,), N.
        noise: RMS error of the needed force for white noise of 1 m of the position, N.
        cut_off: Cut-off of the low-pass, Hz.
    """

    needed: FloatArray
    exerted: FloatArray
    noise: float
    cut_off: float


@runtime_checkable
class HasInverseDynamics(Protocol):
    """A model with inverse dynamics."""

    def balance(self, theta: FloatArray, record: Record) -> Balance:
        """Needed and exerted drive force of a record; RecordingError if there is too little motion."""
        ...


def _smoother(low_pass: LowPass) -> LowPass:
    """The low-pass of the position."""
    return LowPass(POSITION_CUT_OFF_FACTOR * low_pass.cut_off, low_pass.period)


def _judged_rows(
    measured: FloatArray, t: FloatArray, moves: NDArray[np.bool_], low_pass: LowPass
) -> IntArray:
    """Samples of the even times ``t`` (n,) that are compared; ``moves`` (n,) marks motion."""
    span = np.ones(2 * low_pass.reach + 1, dtype=bool)
    after = np.clip(np.searchsorted(measured, t), 1, len(measured) - 1)
    missing = measured[after] - measured[after - 1] > MAX_GAP_IN_PERIODS * low_pass.period
    left_out = ndimage.binary_dilation(ndimage.binary_opening(~moves, span) | missing, span)
    left_out[: 3 * low_pass.reach] = left_out[-3 * low_pass.reach :] = True
    every = max(1, round(1.0 / (ROWS_PER_CUT_OFF_PERIOD * low_pass.cut_off * low_pass.period)))
    rows = np.arange(0, len(t), every)
    return np.asarray(rows[~left_out[rows]], dtype=np.int64)
