"""Whether the sampling itself limits a fit: signals that change faster than they were sampled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from labhil.identify.adequacy import FLOOR_KNOWN_TO
from labhil.identify.fitted import Fitted
from labhil.identify.problem import Problem
from labhil.identify.quantiser import converter_step, uneven_step
from labhil.physics.model import Record
from labhil.physics.terms import keyed
from labhil.signals import FloatArray, Hold

AS_LARGE = 0.5
"""Share of the residual that the run of the input between samples makes up, to be named as a reason.

Squared it is a quarter of what is left: no model can be judged to better than that on such data.
"""

MEAN_OVER = 21
"""Samples over which the mean stands for what a channel reads."""

STILL = 0.02
"""Share of an input's range by which it may change within them."""

BEYOND_ZERO = 0.25
"""Standard deviations beyond zero from which a reading counts as one of the other sign."""

FEWEST_EXPECTED = 20.0
"""Readings of the other sign that noise would make, from which their absence counts …"""

HARDLY_ANY = 0.1
"""… where there are so few of them: by chance as few would be once in 10⁶."""

LIVELY = 0.5
"""Share of its noise that a channel scatters by where it is looked at."""

WHITE = -0.5
"""Correlation of neighbouring third differences from which they are scatter: −0.75 of noise, + of motion."""

OTHER = {Hold.ZERO: Hold.LINEAR, Hold.LINEAR: Hold.ZERO}


def sampling_notes(fitted: Fitted, *, explained: bool) -> tuple[str, ...]:
    """Faults of the sampling of a fit's recording, a text each; none where it is fine.

    A chopped signal takes its own swings for noise, so that also a fit that is ``explained`` may rest on one.
    """
    problem = fitted.problem
    scatter = [
        scattering_statement(problem.record, j, sigma) for j, sigma in enumerate(problem.sigma.tolist())
    ]
    return (*filter(None, scatter), *(() if explained else _coarse_input(fitted)))


def scattering_statement(record: Record, j: int, sigma: float) -> str | None:
    """A note on an output ``j`` that changes between samples as much as over the recording, else None.

    The noise ``sigma`` is read from third differences. Of white noise alone they give its standard deviation;
    only a signal that swings between samples gives more, as a chopped current does.
    """
    spread = float(np.std(record.outputs[:, j]))
    swings = _swings(record, j, sigma)
    if swings is not None:
        return swings
    if not sigma > FLOOR_KNOWN_TO * spread > FLOOR_KNOWN_TO * converter_step(record.outputs[:, j]):
        return None
    name, unit = keyed(*record.channel(j)), record.output_units[j]
    return (
        f"{name} changes as much from one sample to the next ({sigma:.3g} {unit}) as in the whole "
        f"recording ({spread:.3g} {unit}): it was sampled more slowly than it changes, as behind a "
        "chopper (PWM). Its samples say nothing of its mean between them; filter it before sampling, "
        "sample faster, or leave it out."
    )


def _swings(record: Record, j: int, sigma: float) -> str | None:
    """A note on an output ``j`` that scatters by ``sigma`` on one side of zero only while its input is still.

    Noise goes both ways. A current that its chopper interrupts is between nothing and what it is while the
    chopper conducts; sampled at any moment it scatters like white noise. None for other outputs.
    """
    name, joint = record.channel(j)
    x = record.outputs[:, j]
    rounding = max(converter_step(x), uneven_step(x)) / np.sqrt(6.0)
    if joint is not None or len(x) < 2 * MEAN_OVER or not sigma > 3.0 * rounding:
        return None
    moved = np.abs(np.diff(record.inputs, axis=0, prepend=record.inputs[:1]))
    still = ~(maximum_filter1d(moved, MEAN_OVER, axis=0) > STILL * np.ptp(record.inputs, axis=0)).any(axis=1)
    if record.censored is not None:
        # a sensor that knows one direction only is another matter
        still &= record.censored[:, j] == 0
    reads = uniform_filter1d(x, MEAN_OVER)
    third = np.diff(x, 3)
    # a part at rest may show no noise at all
    power = uniform_filter1d(np.pad(third, (1, 2), mode="edge") ** 2, MEAN_OVER) / 20.0
    still &= power > (LIVELY * sigma) ** 2
    crossed = stats.norm.sf(BEYOND_ZERO + np.abs(reads) / sigma) * still
    third = third * np.sqrt(crossed[1:-2])
    white = float(np.sum(third[1:] * third[:-1])) < WHITE * float(np.sum(third**2))
    expected = float(np.sum(crossed))
    beyond = int(np.sum(x[still] * np.sign(reads[still]) < -BEYOND_ZERO * sigma))
    if not white or expected < FEWEST_EXPECTED or beyond > HARDLY_ANY * expected:
        return None
    return (
        f"{name} scatters by {sigma:.3g} {record.output_units[j]} from one sample to the next, but on one "
        f"side of zero only (noise would cross it {expected:.0f} times, this does {beyond} times): it was "
        "sampled more slowly than it changes, as behind a chopper (PWM). Filter it before sampling, sample "
        "faster, or leave it out."
    )


def _coarse_input(fitted: Fitted) -> list[str]:
    """A note where the input between samples moves the simulation by much of the residual."""
    effect = hold_effect(fitted)
    rms = float(np.sqrt(np.mean(fitted.solution.residuals**2)))
    if effect is None or not effect > AS_LARGE * rms:
        return []
    rate = 1.0 / fitted.problem.record.period
    return [
        f"What the input does between samples (held or straight) moves the simulation by {effect:.3g} times "
        f"the noise, and {rms:.3g} times is left: at {rate:.4g} Hz the input is sampled too slowly for this "
        "model, or its hold is not what the recording says. Record it faster, or as it was held."
    ]


def hold_effect(fitted: Fitted) -> float | None:
    """RMS change of the simulation, in units of noise, with held inputs run straight and straight ones held.

    What other initial states of the windows would undo does not count. None by inverse dynamics, which
    simulates nothing.
    """
    if not fitted.problem.model.state_names:
        return None
    change, _ = _change_of_holds(fitted)
    return float(np.sqrt(np.mean(change**2)))


def hold_shifts(fitted: Fitted) -> FloatArray:
    """How far the estimates (P,) would move, to first order, if the input ran otherwise between samples (SI).

    What it did there was not recorded: that much of an estimate is an assumption.
    """
    if not fitted.problem.model.state_names or not len(fitted.problem.free):
        return np.zeros(len(fitted.problem.free))
    change, slopes = _change_of_holds(fitted)
    length = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    shifts, *_ = np.linalg.lstsq(slopes / length, -change, rcond=1e-4)
    return np.asarray(np.abs(shifts / length * fitted.problem.scale))


def _change_of_holds(fitted: Fitted) -> tuple[FloatArray, FloatArray]:
    """Change of the residuals (N·c,) and their slopes by the scaled parameters, windows' states taken out."""
    problem, solution = fitted.problem, fitted.solution
    record = problem.record
    other_record = replace(record, input_holds=tuple(OTHER[hold] for hold in record.input_holds))
    theta = problem.theta(solution.point.z)
    changed = Problem(problem.model, other_record, problem.windows, problem.free, theta, problem.sigma)
    difference = changed.residuals(solution.point) - solution.residuals
    lin = problem.linearise(solution.point, solution.residuals)
    both = problem.project(lin, np.column_stack([difference, lin.by_parameters]))
    return both[:, 0], both[:, 1:]
