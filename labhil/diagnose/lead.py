"""Outputs that respond before their input changes: the stamps of that input are late.

The test looks at isolated steps of a piecewise constant input. A parabola through the samples before a step
predicts an output beyond it; the part of the prediction error that is proportional to the height of the steps
is the response to them. A plant cannot respond at a sample before the step. At the sample of the step itself
it may, in full, where it is faster than the sampling. A response that goes on growing for several samples
began earlier; how much earlier follows from its growth.

An input that moves at every sample shows nothing here: a controller may make such an input of the outputs,
and their correlation does not show which of them was first. For such inputs
:mod:`labhil.diagnose.timing` compares fits of the rig's model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.diagnose.hold import level_changes
from labhil.physics.record import Record
from labhil.signals import FloatArray, Hold, IntArray

MIN_LEAD_SAMPLES: Mapping[Hold, float] = {Hold.ZERO: 0.5, Hold.LINEAR: 1.5}
"""Lead that counts, by the hold of the input: a straight input may move right after the sample before."""


@dataclass(frozen=True, slots=True)
class LeadOptions:
    """Windows and limits of the test for a lead.

    Chosen on simulated recordings of causal plants; see ``tests/analysis/test_intake_inputs.py``.

    Attributes:
        alpha: level of one response: three samples of ten channels stay below 1e-5 for a recording.
        samples_before: a prediction uses samples from this many before a step …
        gap_samples: … to this many before it; later ones may already belong to the response.
        samples_after: samples from a step on in which no other step may come.
        min_steps: steps of an input, at least. A regression on fewer has no reliable errors.
        placebo_samples: samples by which the same test is made earlier, where no response can be. Its result
            is the error of the prediction.
        min_placebo_ratio: size of a response over that error, at least.
        min_onset_share: size of the first response as a share of the response two samples later, at least. A
            lead of half a sample makes 4 %.
    """

    alpha: float = 1e-7
    samples_before: int = 10
    gap_samples: int = 4
    samples_after: int = 3
    min_steps: int = 8
    placebo_samples: int = 4
    min_placebo_ratio: float = 4.0
    min_onset_share: float = 0.02


LEAD_OPTIONS = LeadOptions()
"""The windows and limits that the intake works with."""


@dataclass(frozen=True, slots=True)
class Lead:
    """An output that responds before its input changes.

    Attributes:
        output: column of the output.
        input: column of the input.
        samples: lead in samples.
        p_value: probability that noise makes such a response.
    """

    output: int
    input: int
    samples: float
    p_value: float


def detect_lead(record: Record, *, options: LeadOptions = LEAD_OPTIONS) -> Lead | None:
    """Find the most significant lead of an output over an input.

    Args:
        record: one recording, with increasing time stamps.
        options: windows and limits of the test.

    Returns:
        The lead with the least p value; None where none is significant.
    """
    leads = [
        lead
        for i, u in enumerate(record.inputs.T)
        if len(steps := _isolated_steps(level_changes(u), len(record), options)) >= options.min_steps
        for j, y in enumerate(record.outputs.T)
        if not _depend_on_output(u, y, steps, options.gap_samples)
        and (lead := _lead(record, i, j, steps, options)) is not None
    ]
    return min(leads, key=lambda lead: lead.p_value, default=None)


def _isolated_steps(steps: IntArray, n: int, options: LeadOptions) -> IntArray:
    """The steps that no other step and no end of the ``n`` samples is near, (k,)."""
    gaps = np.diff(np.r_[-n, steps, 2 * n])
    before = options.samples_before + options.placebo_samples
    is_isolated = (gaps[:-1] >= before) & (gaps[1:] > options.samples_after)
    is_inside = (steps >= before) & (steps + options.samples_after < n)
    return steps[is_isolated & is_inside]


def _depend_on_output(u: FloatArray, y: FloatArray, steps: IntArray, gap_samples: int) -> bool:
    """Whether earlier outputs predict the steps, as those of a relay: then the test shows nothing.

    By an F test of a regression of the heights on the output and its change before the steps.
    """
    height = u[steps] - u[steps - 1]
    design = np.column_stack([np.ones(len(steps)), u[steps - 1]])
    earlier = steps - gap_samples
    design_with_output = np.column_stack([design, y[earlier], y[earlier] - y[earlier - 2]])
    residuals = [height - a @ np.linalg.lstsq(a, height, rcond=None)[0] for a in (design, design_with_output)]
    without, with_output = (float(residual @ residual) for residual in residuals)
    freedom = len(steps) - design_with_output.shape[1]
    ratio = (without - with_output) / 2.0 / max(with_output / freedom, 1e-300)
    return bool(with_output < 0.5 * without and stats.f.sf(ratio, 2, freedom) < 1e-3)


def _lead(record: Record, i: int, j: int, steps: IntArray, options: LeadOptions) -> Lead | None:
    """The lead of output ``j`` over input ``i``; None where none is significant."""
    u, y = record.inputs[:, i], record.outputs[:, j]
    height = u[steps] - u[steps - 1]
    first = 2 - options.gap_samples
    responses = [
        _response(record.t, y, steps, k, height, options) for k in range(first, options.samples_after)
    ]
    placebo_steps = steps - options.placebo_samples
    placebo = max(abs(_response(record.t, y, placebo_steps, k, height, options)[0]) for k in (first, 0))
    size = np.array([slope for slope, _ in responses])
    direction = np.sign(size[-1])
    for k, (slope, p_value) in enumerate(responses[: 1 - first]):
        samples_ahead = float(-first - k)
        is_significant = p_value < options.alpha and slope * direction > max(
            options.min_placebo_ratio * placebo, options.min_onset_share * abs(size[k + 2])
        )
        if not is_significant:
            continue
        onset = _onset(size[k : k + 3] * direction)
        if onset is None or onset + samples_ahead < MIN_LEAD_SAMPLES[record.input_holds[i]]:
            return None
        return Lead(j, i, onset + samples_ahead, p_value)
    return None


def _response(
    t: FloatArray, y: FloatArray, steps: IntArray, k: int, height: FloatArray, options: LeadOptions
) -> tuple[float, float]:
    """Response of an output ``k`` samples after the steps per unit of their ``height``, and its p value."""
    rows = steps[:, None] + np.arange(-options.samples_before, -options.gap_samples + 1)
    period = float(np.median(np.diff(t)))
    deviation = np.empty(len(steps))
    for e, step in enumerate(steps):
        along = (t[rows[e]] - t[step]) / period
        # a parabola, as motion is curved: the curvature would otherwise pass for a response
        fit = np.polynomial.polynomial.polyfit(along, y[rows[e]], 2)
        deviation[e] = y[step + k] - np.polynomial.polynomial.polyval((t[step + k] - t[step]) / period, fit)
    power = float(height @ height)
    slope = float(height @ deviation) / power
    residuals = deviation - slope * height
    freedom = len(steps) - 1
    # heteroscedasticity-consistent: errors of a nonlinear plant grow with the step
    error = float(np.sqrt(np.sum((residuals * height) ** 2))) / power * np.sqrt(len(steps) / freedom)
    return slope, float(2.0 * stats.t.sf(abs(slope) / max(error, 1e-300), freedom))


def _onset(response: FloatArray, *, min_decay: float = 0.3, full_share: float = 0.8) -> float | None:
    """Samples by which a response with these values at three neighbouring samples began before the first.

    The response is taken as A·(1 − exp(−a·τ)), or as τ² where it grows faster and faster. None where it is
    complete at once: its first value is at least ``full_share`` of the second (a slow plant's is at most one
    half), or its growth falls below ``min_decay`` within one sample, so that the plant is as fast as the
    sampling.
    """
    first, rise, next_rise = response[0], response[1] - response[0], response[2] - response[1]
    if rise <= (1.0 - full_share) * response[1] or next_rise <= min_decay * rise:
        return None
    decay = next_rise / rise
    if decay > 1.25:
        root = np.sqrt(first / response[1])
        return float(root / (1.0 - root))
    if decay > 0.98:
        return float(first / rise)
    rate = -np.log(decay)
    return float(np.log1p(first * (1.0 - decay) / rise) / rate)
