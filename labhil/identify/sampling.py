"""Whether the sampling itself limits a fit: signals that change faster than they were sampled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labhil.identify.adequacy import FLOOR_KNOWN_TO
from labhil.identify.fitted import Fitted
from labhil.identify.problem import Problem
from labhil.identify.quantiser import converter_step
from labhil.physics.model import Record
from labhil.physics.terms import keyed
from labhil.signals import FloatArray, Hold

AS_LARGE = 0.5
"""Share of the residual that the run of the input between samples makes up, to be named as a reason.

Squared it is a quarter of what is left: no model can be judged to better than that on such data.
"""

OTHER = {Hold.ZERO: Hold.LINEAR, Hold.LINEAR: Hold.ZERO}


def sampling_notes(fitted: Fitted, *, explained: bool) -> tuple[str, ...]:
    """What is to be said of the sampling of a fit's recording, a text each; nothing where it is fine.

    A chopped signal takes its own swings for noise, so that also a fit that is ``explained`` may rest on one.
    """
    problem = fitted.problem
    scatter = [scattering_statement(problem.record, j, each) for j, each in enumerate(problem.sigma.tolist())]
    return (*filter(None, scatter), *(() if explained else _coarse_input(fitted)))


def scattering_statement(record: Record, j: int, sigma: float) -> str | None:
    """What is to be said of an output ``j`` that changes between samples as much as over the recording.

    The noise ``sigma`` is read from third differences. Of white noise alone they give its standard deviation;
    more than that only a signal gives that swings between samples, as a chopped current does. Else None.
    """
    spread = float(np.std(record.outputs[:, j]))
    if not sigma > FLOOR_KNOWN_TO * spread > FLOOR_KNOWN_TO * converter_step(record.outputs[:, j]):
        return None
    name, unit = keyed(*record.channel(j)), record.output_units[j]
    return (
        f"{name} changes as much from one sample to the next ({sigma:.3g} {unit}) as in the whole "
        f"recording ({spread:.3g} {unit}): it was sampled more slowly than it changes, as behind a "
        "chopper (PWM). Its samples say nothing of its mean between them; filter it before sampling, "
        "sample faster, or leave it out."
    )


def _coarse_input(fitted: Fitted) -> list[str]:
    """That what the input does between samples moves the simulation by much of what is left."""
    moved = moved_between_samples(fitted)
    left = float(np.sqrt(np.mean(fitted.solution.residuals**2)))
    if moved is None or not moved > AS_LARGE * left:
        return []
    rate = 1.0 / fitted.problem.record.period
    return [
        f"What the input does between samples (held or straight) moves the simulation by {moved:.3g} times "
        f"the noise, and {left:.3g} times is left: at {rate:.4g} Hz the input is sampled too slowly for this "
        "model, or its hold is not what the recording says. Record it faster, or as it was held."
    ]


def moved_between_samples(fitted: Fitted) -> float | None:
    """RMS change of the simulation, in units of noise, when held inputs run straight and the other way round.

    What other initial states of the windows would undo does not count. None by inverse dynamics, which
    simulates nothing.
    """
    if not fitted.problem.model.state_names:
        return None
    change, _ = _held_otherwise(fitted)
    return float(np.sqrt(np.mean(change**2)))


def moved_estimates(fitted: Fitted) -> FloatArray:
    """How far the estimates (P,) would move, to first order, if the input ran otherwise between samples (SI).

    What it did there was not recorded: that much of an estimate is an assumption.
    """
    if not fitted.problem.model.state_names or not len(fitted.problem.free):
        return np.zeros(len(fitted.problem.free))
    change, slopes = _held_otherwise(fitted)
    length = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    moved, *_ = np.linalg.lstsq(slopes / length, -change, rcond=1e-4)
    return np.asarray(np.abs(moved / length * fitted.problem.scale))


def _held_otherwise(fitted: Fitted) -> tuple[FloatArray, FloatArray]:
    """Change of the residuals (N·c,) and their slopes by the scaled parameters, windows' states taken out."""
    problem, solution = fitted.problem, fitted.solution
    record = problem.record
    other = replace(record, input_holds=tuple(OTHER[hold] for hold in record.input_holds))
    theta = problem.theta(solution.point.z)
    changed = Problem(problem.model, other, problem.windows, problem.free, theta, problem.sigma)
    difference = changed.residuals(solution.point) - solution.residuals
    lin = problem.linearise(solution.point, solution.residuals)
    both = problem.project(lin, np.column_stack([difference, lin.by_parameters]))
    return both[:, 0], both[:, 1:]
