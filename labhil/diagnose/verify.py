"""Does a recording contradict an accepted model: a gate, with a stated probability of a false alarm.

Three questions, each of which gets a third of that probability: is the windowed simulation with the values
as they are worse than noise and the values' own errors explain; does the model, refitted to the recording,
leave residuals that go with the input; and do the refitted values differ from the accepted ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.diagnose import contradiction
from labhil.diagnose.accepted import Accepted
from labhil.diagnose.evidence import effective_samples
from labhil.identify.adequacy import NOISE_FLOOR_FACTOR, Adequacy, adequacy_of
from labhil.identify.continuation import WINDOW_IN_HORIZONS
from labhil.identify.fitted import Fitted, covariances, free_parameter_indices
from labhil.identify.identifiability import undetermined_directions
from labhil.identify.least_squares import least_squares
from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score, score
from labhil.identify.sensitivities import sensitivities
from labhil.identify.window_states import estimate_states
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Metric, Model, Record
from labhil.physics.terms import keyed
from labhil.signals import FloatArray

ALPHA = 1e-3
QUESTIONS = 3
MOST_WINDOWS = 5


@dataclass(frozen=True, slots=True)
class ChannelVerdict:
    """One output against the model: RMSE and floor in ``unit``, their ratio, and what noise rarely exceeds.

    ``rmse_p`` answers whether the simulation is too bad, ``structure_p`` whether the refitted model leaves
    residuals that go with the input. ``allowed`` is the ratio that counts as noise.
    """

    channel: str
    joint: int | None
    unit: str
    rmse: float
    noise_floor: float
    ratio: float
    allowed: float
    limit: float
    rmse_p: float
    structure_p: float


@dataclass(frozen=True, slots=True)
class ValueChange:
    """A parameter as accepted and as this recording would have it; ``std_error`` is of the difference.

    ``p_value`` is corrected for the number of parameters; ``known`` says whether both know it at all.
    """

    name: str
    joint: int | None
    unit: str
    before: float
    after: float
    std_error: float
    z: float
    p_value: float
    changed: bool


@dataclass(frozen=True, slots=True)
class WorstWindow:
    """A scored stretch (begin, end; s) with its RMSE over the noise floor, mean of the channels."""

    begin: float
    end: float
    ratio: float


@dataclass(frozen=True, slots=True)
class Verification:
    """The answer: ``consistent`` unless the smallest p value, times the questions, is under ``alpha``.

    ``values_p`` is that of all values together; ``reasons`` say what contradicts, a sentence each;
    ``notes`` what the answer had to do without; ``adequacy`` says whether the values as they are explain the
    recording, which is another question than whether it contradicts a model that never fitted to the noise.
    """

    consistent: bool
    alpha: float
    p_value: float
    channels: tuple[ChannelVerdict, ...]
    values_p: float
    changes: tuple[ValueChange, ...]
    worst: tuple[WorstWindow, ...]
    score: Score
    refit: Fitted
    window: float
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    adequacy: Adequacy


def verify(
    model: Model,
    record: Record,
    accepted: Accepted,
    *,
    alpha: float = ALPHA,
    progress: Callable[[str], None] = lambda text: None,
) -> Verification:
    """Hold a ``model.prepare``d record against a model with values; no data are held out, none are needed.

    Raises ModelFileError when the values do not fit the model, RecordingError when the record is too short.
    """
    theta = accepted.vector(model)
    sigma = noise_of(record)
    progress("simulating with the values as they are")
    marks = score(model, theta, record, sigma)
    progress("refitting the model to this recording")
    window = min(accepted.window or WINDOW_IN_HORIZONS * model.horizon, float(record.t[-1] - record.t[0]))
    refit = _refit(model, record, accepted, theta, window, sigma)
    progress("comparing")
    robust, _, jacobian = covariances(refit)
    keys = [model.parameters[i].key for i in refit.problem.free]
    before = accepted.covariance_of(keys)
    channels = _channels(model, record, accepted, marks, theta, before, refit, jacobian)
    values_p, changes = _changes(refit, theta, before + robust, alpha)
    p_values = [min(1.0, len(channels) * min(c.rmse_p for c in channels))]
    p_values += [min(1.0, len(channels) * min(c.structure_p for c in channels)), values_p]
    p_value = float(min(1.0, QUESTIONS * min(p_values)))
    return Verification(
        consistent=p_value >= alpha,
        alpha=alpha,
        p_value=p_value,
        channels=channels,
        values_p=values_p,
        changes=changes,
        worst=_worst(marks, record),
        score=marks,
        refit=refit,
        window=window,
        reasons=_reasons(channels, values_p, changes, alpha / QUESTIONS),
        notes=_notes(accepted, model),
        adequacy=adequacy_of([marks]),
    )


def _refit(
    model: Model, record: Record, accepted: Accepted, theta: FloatArray, window: float, sigma: FloatArray
) -> Fitted:
    """The model's free parameters on this record, from the accepted values."""
    dynamics = model.metric is Metric.INVERSE_DYNAMICS
    length = float(record.t[-1] - record.t[0]) if dynamics else window
    fitted = _fit(model, record, accepted, theta, length, sigma)
    for _ in range(2 if dynamics else 0):
        spread = np.sqrt(np.mean(fitted.solution.residuals.reshape(-1, len(sigma)) ** 2, axis=0))
        sigma = sigma * np.maximum(spread, 1e-6)
        fitted = _fit(model, record, accepted, theta, length, sigma)
    return fitted


def _fit(
    model: Model, record: Record, accepted: Accepted, theta: FloatArray, length: float, sigma: FloatArray
) -> Fitted:
    """Least squares from ``theta``; one parameter of a direction that the data do not know stays there."""
    windows = fit_windows(record, length)
    free = free_parameter_indices(model, accepted.terms)
    problem = Problem(model, record, windows, free, theta, sigma)
    z = problem.start().z
    states = estimate_states(problem, z, thorough=False).states
    residuals = problem.residuals(Point(z, states))
    noise = float(np.sqrt(np.mean(residuals**2)))
    slopes = sensitivities(problem, Point(z, states), residuals, noise) / problem.scale
    lost, _ = undetermined_directions([model.parameters[i] for i in free], theta[free], slopes, noise)
    known = np.delete(np.arange(len(free)), lost)
    pinned = problem.pin(lost, theta)
    solution = least_squares(pinned, Point(z[known], states), settled=True)
    estimate = z.copy()
    estimate[known] = solution.point.z
    point = Point(estimate, solution.point.states)
    extended = type(solution)(point, solution.residuals, solution.iterations, solution.converged)
    return Fitted(accepted.terms, problem.theta(estimate), problem, extended, length)


def _channels(
    model: Model,
    record: Record,
    accepted: Accepted,
    marks: Score,
    theta: FloatArray,
    covariance: FloatArray,
    refit: Fitted,
    jacobian: FloatArray,
) -> tuple[ChannelVerdict, ...]:
    sigma, free = noise_of(record), refit.problem.free
    scored = Problem(model, record, marks.windows.whole, free, theta, sigma)
    slopes = contradiction.scored_slopes(scored, marks) / scored.scale
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    solution = refit.solution
    structure = contradiction.structure_p_value(refit.problem, solution.point, solution.residuals, jacobian)
    verdicts = []
    for j, channel in enumerate(marks.channels):
        ratio_key = keyed(channel.channel, channel.joint)
        reached = float(refit.problem.sigma[j]) / channel.noise_floor
        dynamics = model.metric is Metric.INVERSE_DYNAMICS
        allowed = accepted.allowed_ratio(ratio_key, reached if dynamics else None)
        channel_slopes = slopes[j :: len(sigma)] * sigma[j]
        limited = NOISE_FLOOR_FACTOR * allowed
        p_value, limit = contradiction.excess_p_value(
            marks, j, channel_slopes, finite, limited, allowed > 1.0
        )
        verdicts.append(
            ChannelVerdict(
                channel=channel.channel,
                joint=channel.joint,
                unit=channel.unit,
                rmse=channel.rmse,
                noise_floor=channel.noise_floor,
                ratio=channel.rmse / channel.noise_floor,
                allowed=allowed,
                limit=limit,
                rmse_p=p_value,
                structure_p=structure[j],
            )
        )
    return tuple(verdicts)


def _changes(
    refit: Fitted, theta: FloatArray, covariance: FloatArray, alpha: float
) -> tuple[float, tuple[ValueChange, ...]]:
    """p value of all differences together, and a row for each parameter."""
    free = refit.problem.free
    difference = refit.theta[free] - theta[free]
    effective = effective_samples(refit)
    together = contradiction.difference_p_value(difference, covariance, effective)
    rows = []
    for i, place in enumerate(free):
        parameter = refit.problem.model.parameters[place]
        error = float(np.sqrt(max(covariance[i, i], 0.0)))
        z = float(difference[i] / error) if np.isfinite(error) and error > 0.0 else 0.0
        p_value = min(1.0, len(free) * float(2.0 * stats.norm.sf(abs(z))))
        rows.append(
            ValueChange(
                name=parameter.name,
                joint=parameter.joint,
                unit=parameter.unit,
                before=float(theta[place]),
                after=float(refit.theta[place]),
                std_error=error,
                z=z,
                p_value=p_value,
                changed=p_value < alpha / QUESTIONS,
            )
        )
    return together, tuple(rows)


def _worst(marks: Score, record: Record) -> tuple[WorstWindow, ...]:
    """The scored stretches that are simulated worst, the worst first."""
    floor = np.array([channel.noise_floor for channel in marks.channels])
    stretches = []
    for w in np.unique(marks.window):
        rows = marks.window == w
        ratio = float(np.mean(np.sqrt(np.mean(marks.errors[rows] ** 2, axis=0)) / floor))
        times = record.t[marks.rows[rows]]
        stretches.append(WorstWindow(float(times[0]), float(times[-1]), ratio))
    return tuple(sorted(stretches, key=lambda stretch: -stretch.ratio)[:MOST_WINDOWS])


def _reasons(
    channels: tuple[ChannelVerdict, ...], values_p: float, changes: tuple[ValueChange, ...], level: float
) -> tuple[str, ...]:
    reasons = []
    threshold = level / len(channels)
    for c in channels:
        name = keyed(c.channel, c.joint)
        if c.rmse_p < threshold:
            reasons.append(
                f"The simulation of {name} misses by {c.rmse:.4g} {c.unit}, {c.ratio:.3g} times the noise "
                f"floor; noise and the errors of the values explain at most {c.limit:.3g} times."
            )
        if c.structure_p < threshold:
            reasons.append(
                f"Whatever its parameters, the model leaves residuals of {name} that go with the input "
                f"(p = {c.structure_p:.2g}): physics is missing. `labhil diagnose` looks for it."
            )
    if values_p < level:
        names = [keyed(c.name, c.joint) for c in changes if c.changed]
        say = ", ".join(names) or "no single one beyond doubt, but a combination of them"
        reasons.append(f"Values have changed (p = {values_p:.2g}): {say}.")
    return tuple(reasons)


def _notes(accepted: Accepted, model: Model) -> tuple[str, ...]:
    notes = []
    if accepted.covariance is None:
        notes.append(f"{accepted.name} holds no errors of its values: they are taken as exact.")
    if model.metric is Metric.INVERSE_DYNAMICS and not accepted.residual_ratio:
        notes.append(
            f"{accepted.name} does not say how well it fitted: the noise floor alone is the yardstick."
        )
    return tuple(notes)


__all__ = ["ALPHA", "ChannelVerdict", "ValueChange", "Verification", "WorstWindow", "verify"]
