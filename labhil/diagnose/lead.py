"""Outputs that answer before their input: a command whose stamps are late, which no plant can be.

Looked at are single jumps of an input that is held in levels: what comes before a jump predicts an output
beyond it, and the difference that goes with the jumps is the answer to them. A plant cannot answer at a
sample before the jump's. At the jump's own sample it may, in full, where it is faster than the sampling; one
whose answer goes on growing for samples had begun before. How long before follows from how it grows.

An input that moves at every sample shows nothing here: a controller makes such inputs of outputs, and their
correlation does not show which was first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.diagnose.hold import jumps_of_levels
from labhil.physics.model import Record
from labhil.signals import FloatArray, Hold, IntArray

CHANCE = 1e-7
"""Probability that noise makes one answer: three samples of ten channels stay under 1e-5 a recording."""

BEFORE, FREE = 10, 4
"""Samples before a jump that predict an output; the last ``FREE`` − 1 may belong to the answer."""

AFTER = 3
"""Samples from a jump on, in which no other one may come."""

FEWEST_JUMPS = 8
"""A regression on fewer has no errors that could be relied upon."""

PLACEBO = 4
"""Samples earlier at which the same is done, where no answer can be: it finds the extrapolation's error."""

OVER_PLACEBO = 4.0
"""An answer is so many times as large as that error."""

STARTED = 0.02
"""Of the answer two samples on, what a sample must show of it: an answer by a lead of a half shows 4 %."""

TOO_FAST = 0.3
"""Share of an answer's growth that is left after one sample, under which the plant is as fast as sampling."""

IN_FULL = 0.8
"""Share of the next sample's answer from which a first one is all there: a slow plant's is a half at most."""

LEAST = {Hold.ZERO: 0.5, Hold.LINEAR: 1.5}
"""Samples of lead that count: what is straight between samples may have moved right after the one before."""


@dataclass(frozen=True, slots=True)
class Lead:
    """By how many samples an ``output`` column answers before an ``input`` column; ``p_value`` by chance."""

    output: int
    input: int
    samples: float
    p_value: float


def lead_of(record: Record) -> Lead | None:
    """The most certain lead of an output of one recording over an input; None where none is beyond doubt."""
    leads = [
        lead
        for i, u in enumerate(record.inputs.T)
        if len(jumps := _lone_jumps(jumps_of_levels(u), len(record))) >= FEWEST_JUMPS
        for j, y in enumerate(record.outputs.T)
        if not _follows(u, y, jumps) and (lead := _lead(record, i, j, jumps)) is not None
    ]
    return min(leads, key=lambda lead: lead.p_value, default=None)


def _lone_jumps(jumps: IntArray, n: int) -> IntArray:
    """The jumps that no other one is near, (k,)."""
    gaps = np.diff(np.r_[-n, jumps, 2 * n])
    alone = (gaps[:-1] >= BEFORE + PLACEBO) & (gaps[1:] > AFTER)
    room = (jumps >= BEFORE + PLACEBO) & (jumps + AFTER < n)
    return jumps[alone & room]


def _follows(u: FloatArray, y: FloatArray, jumps: IntArray) -> bool:
    """Whether jumps are made of the output, as a relay's are: then both go together whoever was first."""
    height = u[jumps] - u[jumps - 1]
    design = np.column_stack([np.ones(len(jumps)), u[jumps - 1]])
    earlier = jumps - FREE
    design_with_output = np.column_stack([design, y[earlier], y[earlier] - y[earlier - 2]])
    residuals = [height - a @ np.linalg.lstsq(a, height, rcond=None)[0] for a in (design, design_with_output)]
    without, with_output = (float(residual @ residual) for residual in residuals)
    freedom = len(jumps) - design_with_output.shape[1]
    ratio = (without - with_output) / 2.0 / max(with_output / freedom, 1e-300)
    return bool(with_output < 0.5 * without and stats.f.sf(ratio, 2, freedom) < 1e-3)


def _lead(record: Record, i: int, j: int, jumps: IntArray) -> Lead | None:
    u, y = record.inputs[:, i], record.outputs[:, j]
    height = u[jumps] - u[jumps - 1]
    first = 2 - FREE
    answers = [_answer(record.t, y, jumps, k, height) for k in range(first, AFTER)]
    placebo = max(abs(_answer(record.t, y, jumps - PLACEBO, k, height)[0]) for k in (first, 0))
    size = np.array([slope for slope, _ in answers])
    direction = np.sign(size[-1])
    for k, (slope, p_value) in enumerate(answers[: 1 - first]):
        ahead = float(-first - k)
        sure = p_value < CHANCE and slope * direction > max(
            OVER_PLACEBO * placebo, STARTED * abs(size[k + 2])
        )
        if not sure:
            continue
        onset = _onset(size[k : k + 3] * direction)
        if onset is None or onset + ahead < LEAST[record.input_holds[i]]:
            return None
        return Lead(j, i, onset + ahead, p_value)
    return None


def _answer(t: FloatArray, y: FloatArray, jumps: IntArray, k: int, height: FloatArray) -> tuple[float, float]:
    """Slope of an output's deviation ``k`` samples on over the jumps' ``height``, and its p value."""
    rows = jumps[:, None] + np.arange(-BEFORE, -FREE + 1)
    period = float(np.median(np.diff(t)))
    deviation = np.empty(len(jumps))
    for e, jump in enumerate(jumps):
        along = (t[rows[e]] - t[jump]) / period
        # bent as motion is: a line would take its curvature for an answer
        fit = np.polynomial.polynomial.polyfit(along, y[rows[e]], 2)
        deviation[e] = y[jump + k] - np.polynomial.polynomial.polyval((t[jump + k] - t[jump]) / period, fit)
    power = float(height @ height)
    slope = float(height @ deviation) / power
    residuals = deviation - slope * height
    freedom = len(jumps) - 1
    # errors that grow with the jump, as those of a plant that is not linear, count as they are
    error = float(np.sqrt(np.sum((residuals * height) ** 2))) / power * np.sqrt(len(jumps) / freedom)
    return slope, float(2.0 * stats.t.sf(abs(slope) / max(error, 1e-300), freedom))


def _onset(growth: FloatArray) -> float | None:
    """Samples before the first of three neighbours at which an answer that grows like these began.

    By A·(1 − exp(−a·τ)), or by τ² where it grows faster and faster. None where it is all there at once.
    """
    first, rise, more = growth[0], growth[1] - growth[0], growth[2] - growth[1]
    if rise <= (1.0 - IN_FULL) * growth[1] or more <= TOO_FAST * rise:
        return None
    share = more / rise
    if share > 1.25:
        root = np.sqrt(first / growth[1])
        return float(root / (1.0 - root))
    if share > 0.98:
        return float(first / rise)
    rate = -np.log(share)
    return float(np.log1p(first * (1.0 - share) / rise) / rate)


__all__ = ["Lead", "lead_of"]
