"""Notes on sampling that is too slow: outputs behind a chopper, and inputs that change between samples.

``fit`` adds them to its result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from labhil.identify.adequacy import NOISE_FLOOR_FACTOR
from labhil.identify.fitted import Fitted
from labhil.identify.problem import Problem
from labhil.identify.quantiser import converter_step, uneven_step
from labhil.physics.record import Record
from labhil.physics.terms import keyed
from labhil.signals import FloatArray, Hold

OPPOSITE_HOLD = {Hold.ZERO: Hold.LINEAR, Hold.LINEAR: Hold.ZERO}


@dataclass(frozen=True, slots=True)
class ChopperOptions:
    """When an output counts as chopped: it scatters like noise, but on one side of zero only.

    Attributes:
        window: Samples over which the channel's mean and scatter are taken.
        max_input_change: Change of an input within such a window, as a share of its range, up to which the
            input counts as constant.
        min_scatter: Scatter within a window, as a share of the channel's noise, from which the window counts.
        zero_margin: Standard deviations beyond zero from which a reading counts as one of the other sign.
        min_expected: Readings of the other sign that noise would cause, from which their absence counts.
        max_share: Share of those that may occur; by chance so few would occur once in 10⁶.
        max_correlation: Lag-one correlation of third differences below which the scatter counts as white:
            it is −0.75 of white noise and positive of a motion.
    """

    window: int = 21
    max_input_change: float = 0.02
    min_scatter: float = 0.5
    zero_margin: float = 0.25
    min_expected: float = 20.0
    max_share: float = 0.1
    max_correlation: float = -0.5


DEFAULT_CHOPPER = ChopperOptions()


def sampling_notes(fitted: Fitted, *, explained: bool) -> tuple[str, ...]:
    """Describe faults of the sampling of a fit's recording.

    Args:
        fitted: The fit.
        explained: Whether the model explains its data. If so only chopped outputs are reported: their
            swings count as noise, so that a fit may look good.

    Returns:
        A text for each fault.
    """
    problem = fitted.problem
    scatter = [
        scattering_statement(problem.record, j, sigma) for j, sigma in enumerate(problem.sigma.tolist())
    ]
    return (*filter(None, scatter), *(() if explained else _coarse_input(fitted)))


def scattering_statement(record: Record, j: int, sigma: float) -> str | None:
    """Describe an output that changes between samples as much as over the whole recording.

    Of a signal plus white noise, third differences give the noise's standard deviation; a signal that swings
    between samples, as a chopped current does, gives more than its own standard deviation.

    Args:
        record: What was measured.
        j: Index of the output.
        sigma: Its noise from third differences, in its unit.

    Returns:
        A text; None where the output is sampled fast enough.
    """
    spread = float(np.std(record.outputs[:, j]))
    chopped = _chopped_statement(record, j, sigma)
    if chopped is not None:
        return chopped
    if not sigma > NOISE_FLOOR_FACTOR * spread > NOISE_FLOOR_FACTOR * converter_step(record.outputs[:, j]):
        return None
    name, unit = keyed(*record.channel(j)), record.output_units[j]
    return (
        f"{name} changes as much from one sample to the next ({sigma:.3g} {unit}) as in the whole "
        f"recording ({spread:.3g} {unit}): it was sampled more slowly than it changes, as behind a "
        "chopper (PWM). Its samples say nothing of its mean between them; filter it before sampling, "
        "sample faster, or leave it out."
    )


def _chopped_statement(
    record: Record, j: int, sigma: float, options: ChopperOptions = DEFAULT_CHOPPER
) -> str | None:
    """A note on an output ``j`` that scatters by ``sigma`` on one side of zero only, else None.

    A current that its chopper interrupts lies anywhere between zero and its value while the chopper conducts;
    sampled at any moment it scatters like white noise, but noise crosses zero. Only samples at a constant
    input count.
    """
    name, joint = record.channel(j)
    x = record.outputs[:, j]
    rounding = max(converter_step(x), uneven_step(x)) / np.sqrt(6.0)
    if joint is not None or len(x) < 2 * options.window or not sigma > 3.0 * rounding:
        return None
    changes = np.abs(np.diff(record.inputs, axis=0, prepend=record.inputs[:1]))
    limits = options.max_input_change * np.ptp(record.inputs, axis=0)
    counted = ~(maximum_filter1d(changes, options.window, axis=0) > limits).any(axis=1)
    if record.censored is not None:
        # a sensor that reads one direction only is no chopper
        counted &= record.censored[:, j] == 0
    mean = uniform_filter1d(x, options.window)
    third = np.diff(x, 3)
    # a part at rest may show no noise at all
    power = uniform_filter1d(np.pad(third, (1, 2), mode="edge") ** 2, options.window) / 20.0
    counted &= power > (options.min_scatter * sigma) ** 2
    probability = stats.norm.sf(options.zero_margin + np.abs(mean) / sigma) * counted
    third = third * np.sqrt(probability[1:-2])
    is_white = float(np.sum(third[1:] * third[:-1])) < options.max_correlation * float(np.sum(third**2))
    expected = float(np.sum(probability))
    crossings = int(np.sum(x[counted] * np.sign(mean[counted]) < -options.zero_margin * sigma))
    if not is_white or expected < options.min_expected or crossings > options.max_share * expected:
        return None
    return (
        f"{name} scatters by {sigma:.3g} {record.output_units[j]} from one sample to the next, but on one "
        f"side of zero only (noise would cross it {expected:.0f} times, this does {crossings} times): it was "
        "sampled more slowly than it changes, as behind a chopper (PWM). Filter it before sampling, sample "
        "faster, or leave it out."
    )


def _coarse_input(fitted: Fitted, *, min_residual_share: float = 0.5) -> list[str]:
    """A note where the input between samples changes the simulation by a large share of the residual.

    At half of the RMS residual, the input's course between samples is a quarter of its mean square.
    """
    effect = hold_effect(fitted)
    rms = float(np.sqrt(np.mean(fitted.solution.residuals**2)))
    if effect is None or not effect > min_residual_share * rms:
        return []
    rate = 1.0 / fitted.problem.record.period
    return [
        f"What the input does between samples (held or straight) moves the simulation by {effect:.3g} times "
        f"the noise, and {rms:.3g} times is left: at {rate:.4g} Hz the input is sampled too slowly for this "
        "model, or its hold is not what the recording says. Record it faster, or as it was held."
    ]


def hold_effect(fitted: Fitted) -> float | None:
    """RMS change of the simulation by the opposite assumption on the input between samples.

    Inputs that were held run straight from sample to sample, and the reverse. The windows' initial states are
    projected out.

    Returns:
        In units of noise; None of inverse dynamics, which simulates nothing.
    """
    if not fitted.problem.model.state_names:
        return None
    change, _ = _change_of_holds(fitted)
    return float(np.sqrt(np.mean(change**2)))


def hold_shifts(fitted: Fitted) -> FloatArray:
    """Changes of the estimates, to first order, by the opposite assumption on the input between samples.

    The course of the input there was not recorded: that much of an estimate is an assumption.

    Returns:
        (P,) absolute values, SI units.
    """
    if not fitted.problem.model.state_names or not len(fitted.problem.free):
        return np.zeros(len(fitted.problem.free))
    change, slopes = _change_of_holds(fitted)
    length = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    shifts, *_ = np.linalg.lstsq(slopes / length, -change, rcond=1e-4)
    return np.asarray(np.abs(shifts / length * fitted.problem.scale))


def _change_of_holds(fitted: Fitted) -> tuple[FloatArray, FloatArray]:
    """Change of the residuals (N·c,) by opposite holds, and their slopes by scaled parameters (N·c, P).

    The windows' initial states are projected out of both.
    """
    problem, solution = fitted.problem, fitted.solution
    record = problem.record
    other_record = replace(record, input_holds=tuple(OPPOSITE_HOLD[hold] for hold in record.input_holds))
    theta = problem.theta(solution.point.z)
    changed = Problem(problem.model, other_record, problem.windows, problem.free, theta, problem.sigma)
    difference = changed.residuals(solution.point) - solution.residuals
    lin = problem.linearise(solution.point, solution.residuals)
    columns = problem.project(lin, np.column_stack([difference, lin.by_parameters]))
    return columns[:, 0], columns[:, 1:]
