"""What the drive of an axis had to push for the measured motion, beside what it did push.

The position passes a zero-phase low-pass at three times the cut-off and is differentiated twice; the force
that the model needs for that motion, and the force of the drive, both pass another one at the cut-off
(parallel filtering: Gautier 1997; Janot, Gautier, Brunot 2019 on the benchmark EMPS). The first is wider so
that a reversal, at which dry friction jumps, stays where it was. Where the axis rests dry friction takes any
value within its level, so nothing is judged there, nor near ends and gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from labhil.errors import RecordingError
from labhil.physics.arm.motion import FEWEST, GAP, KEPT_PER_CUT_OFF, LowPass
from labhil.physics.model import Record
from labhil.signals import FloatArray, IntArray

CUT_OFF = 20.0
"""Hz; where the rig file's [metric] says nothing."""

WIDER = 3.0
"""The low-pass of the position lies this much above that of the forces."""

HIGHEST_SHARE = 0.1
"""Of the sampling rate: the highest cut-off, with room for the wider low-pass."""

REST = 0.01
"""Share of the RMS speed below which the axis rests, where that lasts for longer than the filter's reach."""


ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
"""Share of a position within which readings of an axis at rest may stray."""


@dataclass(frozen=True, slots=True, eq=False)
class DriveMotion:
    """The measured motion on an even raster, smooth enough for two derivatives.

    ``t`` s, ``x`` m, ``v`` m/s, ``a`` m/s², each (n,); ``rows`` (k,) are the places that are judged, about
    2.5 per period of the cut-off; ``low_pass`` is the filter of the forces.
    """

    t: FloatArray
    x: FloatArray
    v: FloatArray
    a: FloatArray
    rows: IntArray
    low_pass: LowPass

    @classmethod
    def of(cls, record: Record, cut_off: float = CUT_OFF) -> DriveMotion:
        """The motion of a record's first output; RecordingError when hardly anything moves."""
        period = record.period
        t = record.t[0] + period * np.arange(int((record.t[-1] - record.t[0]) / period + 1e-6) + 1)
        low_pass = LowPass(min(cut_off, HIGHEST_SHARE / period), period)
        if len(t) < max(FEWEST, 8 * low_pass.reach):
            raise RecordingError(f"too short for inverse dynamics: {len(t)} samples")
        x = _smoother(low_pass)(np.interp(t, record.t, record.outputs[:, 0]))
        v = np.gradient(x, period)
        rounding = ROUNDING * float(np.abs(x).max()) / period
        rows = _judged_rows(
            record.t, t, np.abs(v) > max(REST * float(np.sqrt(np.mean(v**2))), rounding), low_pass
        )
        if len(rows) < FEWEST:
            raise RecordingError(
                f"too little motion for inverse dynamics: {len(rows)} places are left below "
                f"{low_pass.cut_off:g} Hz, at least {FEWEST} are needed"
            )
        return cls(t, x, v, np.gradient(v, period), rows, low_pass)

    def at_judged(self, force: FloatArray) -> FloatArray:
        """What is left of a force (n,) behind the low-pass at the places that are judged, (k,)."""
        return self.low_pass(force)[self.rows]

    def drive(self, nodes: FloatArray, values: FloatArray) -> FloatArray:
        """What is left behind the low-pass, (k,), of a drive that is straight between ``nodes`` (m,) s.

        A held drive jumps at the samples: the mean of both sides is what is in effect there.
        """
        half = 0.5 * self.low_pass.period
        both = np.interp(self.t - half, nodes, values) + np.interp(self.t + half, nodes, values)
        return self.at_judged(0.5 * both)

    @property
    def noise(self) -> float:
        """What white noise of 1 m of the position makes of the judged acceleration, RMS in m/s²."""
        impulse = np.zeros(16 * self.low_pass.reach + 1)
        impulse[len(impulse) // 2] = 1.0
        smooth = _smoother(self.low_pass)(impulse)
        period = self.low_pass.period
        return float(np.linalg.norm(self.low_pass(np.gradient(np.gradient(smooth, period), period))))


@dataclass(frozen=True, slots=True)
class Balance:
    """Force that a motion needs and force that the drive exerted, each (k,) N, and what noise does to it.

    ``noise`` is the RMS error in N that white noise of 1 m of the position makes of the needed one.
    """

    needed: FloatArray
    exerted: FloatArray
    noise: float
    cut_off: float


@runtime_checkable
class HasInverseDynamics(Protocol):
    """A model that can say what its drive had to push."""

    def balance(self, theta: FloatArray, record: Record) -> Balance:
        """The judged forces of a record; RecordingError when hardly anything moves."""
        ...


def _smoother(low_pass: LowPass) -> LowPass:
    return LowPass(WIDER * low_pass.cut_off, low_pass.period)


def _judged_rows(
    measured: FloatArray, t: FloatArray, moves: NDArray[np.bool_], low_pass: LowPass
) -> IntArray:
    """Places of the even raster ``t`` (n,) that are judged, thinned out; ``moves`` (n,) where it does."""
    span = np.ones(2 * low_pass.reach + 1, dtype=bool)
    after = np.clip(np.searchsorted(measured, t), 1, len(measured) - 1)
    missing = measured[after] - measured[after - 1] > GAP * low_pass.period
    left_out = ndimage.binary_dilation(ndimage.binary_opening(~moves, span) | missing, span)
    left_out[: 3 * low_pass.reach] = left_out[-3 * low_pass.reach :] = True
    every = max(1, round(1.0 / (KEPT_PER_CUT_OFF * low_pass.cut_off * low_pass.period)))
    rows = np.arange(0, len(t), every)
    return np.asarray(rows[~left_out[rows]], dtype=np.int64)
