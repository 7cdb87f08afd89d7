"""Verification: does a recording contradict an accepted model, at a given probability of a false alarm?

Three tests share that probability equally (Bonferroni's correction): is the windowed simulation with the
accepted values worse than noise and the errors of the values explain; are the residuals of the refitted model
correlated with the input; and do the refitted values differ from the accepted ones? The statistics are in
``contradiction.py``.
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
from labhil.identify.fitted import Fitted, free_parameter_indices
from labhil.identify.identifiability import undetermined_directions
from labhil.identify.least_squares import least_squares
from labhil.identify.problem import Point, Problem
from labhil.identify.score import Score, score
from labhil.identify.sensitivities import sensitivities
from labhil.identify.window_states import estimate_states
from labhil.identify.windows import fit_windows, noise_of
from labhil.physics.model import Metric, Model
from labhil.physics.record import Record
from labhil.physics.terms import keyed
from labhil.signals import FloatArray

ALPHA = 1e-3
"""Default level α: the probability that a recording contradicts a model that is right."""

N_TESTS = 3
"""Number of tests that share the level: simulation, residuals, values."""


@dataclass(frozen=True, slots=True)
class ChannelVerdict:
    """The tests of one output.

    Attributes:
        channel: name of the output.
        joint: its joint, of an arm.
        unit: unit of RMSE and floor.
        rmse: RMSE of the simulation with the accepted values.
        noise_floor: its noise floor.
        ratio: RMSE over noise floor.
        allowed: ratio that counts as noise.
        limit: ratio that noise and the errors of the values rarely exceed.
        rmse_p: p value that the simulation is no worse than these explain.
        structure_p: p value that the residuals of the refitted model are not correlated with the input.
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
    """A parameter as accepted (``before``) and as refitted (``after``).

    ``std_error`` is that of the difference, ``z`` the difference over it. ``p_value`` is corrected for the
    number of parameters; ``changed`` is whether it is significant.
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
    """A scored window (begin, end; s) with its RMSE over the noise floor, mean of the channels."""

    begin: float
    end: float
    ratio: float


@dataclass(frozen=True, slots=True)
class Verification:
    """The answer of a verification.

    Attributes:
        consistent: whether the p value is at least ``alpha``.
        alpha: level of all tests together.
        p_value: smallest p value of the tests, times their number.
        channels: the tests of each output.
        values_p: p value that no value has changed, of all values together.
        changes: each value, accepted and refitted.
        worst: the windows that are simulated worst.
        score: score of the accepted values.
        refit: the model refitted to the recording.
        window: length of the windows of that fit, s.
        reasons: a sentence for each contradiction.
        notes: sentences on information that was not available.
        adequacy: whether the accepted values explain the recording; a recording may be consistent with a
            model that never fitted to the noise.
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
    """Test whether a recording contradicts an accepted model.

    Args:
        model: the model.
        record: the recording as ``model.prepare`` returns it; no part of it is held out.
        accepted: the accepted values with their covariance.
        alpha: probability of a false alarm.
        progress: is called with a line of text at each stage.

    Returns:
        The answer.

    Raises:
        ModelFileError: if the values do not fit the model.
        RecordingError: if the recording is too short.
    """
    theta = accepted.vector(model)
    sigma = noise_of(record)
    progress("simulating with the values as they are")
    accepted_score = score(model, theta, record, sigma)
    progress("refitting the model to this recording")
    window = min(accepted.window or WINDOW_IN_HORIZONS * model.horizon, float(record.t[-1] - record.t[0]))
    refit = _refit(model, record, accepted, theta, window, sigma)
    progress("comparing")
    robust, _, jacobian = refit.covariances
    keys = [model.parameters[i].key for i in refit.problem.free]
    before = accepted.covariance_of(keys)
    channels = _channels(model, record, accepted, accepted_score, theta, before, refit, jacobian)
    values_p, changes = _changes(refit, theta, before + robust, alpha)
    p_values = [min(1.0, len(channels) * min(c.rmse_p for c in channels))]
    p_values += [min(1.0, len(channels) * min(c.structure_p for c in channels)), values_p]
    p_value = float(min(1.0, N_TESTS * min(p_values)))
    return Verification(
        consistent=p_value >= alpha,
        alpha=alpha,
        p_value=p_value,
        channels=channels,
        values_p=values_p,
        changes=changes,
        worst=_worst_windows(accepted_score, record),
        score=accepted_score,
        refit=refit,
        window=window,
        reasons=_reasons(channels, values_p, changes, alpha / N_TESTS),
        notes=_notes(accepted, model),
        adequacy=adequacy_of([accepted_score]),
    )


def _refit(
    model: Model, record: Record, accepted: Accepted, theta: FloatArray, window: float, sigma: FloatArray
) -> Fitted:
    """Refit the free parameters to the recording, from the accepted values.

    The noise of inverse dynamics follows from the residuals, in two rounds.
    """
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
    """Fit by least squares from ``theta``; of each undetermined direction one parameter is held there."""
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
    accepted_score: Score,
    theta: FloatArray,
    covariance: FloatArray,
    refit: Fitted,
    jacobian: FloatArray,
) -> tuple[ChannelVerdict, ...]:
    """The tests of each output, by simulation and by residuals."""
    sigma, free = noise_of(record), refit.problem.free
    scored = Problem(model, record, accepted_score.windows.whole, free, theta, sigma)
    slopes = contradiction.scored_slopes(scored, accepted_score) / scored.scale
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    solution = refit.solution
    structure = contradiction.structure_p_value(refit.problem, solution.point, solution.residuals, jacobian)
    verdicts = []
    for j, channel in enumerate(accepted_score.channels):
        ratio_key = keyed(channel.channel, channel.joint)
        reached = float(refit.problem.sigma[j]) / channel.noise_floor
        dynamics = model.metric is Metric.INVERSE_DYNAMICS
        allowed = accepted.allowed_ratio(ratio_key, reached if dynamics else None)
        channel_slopes = slopes[j :: len(sigma)] * sigma[j]
        limited = NOISE_FLOOR_FACTOR * allowed
        p_value, limit = contradiction.excess_p_value(
            accepted_score, j, channel_slopes, finite, limited, allowed > 1.0
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
    """p value of all differences together, and the test of each parameter."""
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
                changed=p_value < alpha / N_TESTS,
            )
        )
    return together, tuple(rows)


def _worst_windows(accepted_score: Score, record: Record, most: int = 5) -> tuple[WorstWindow, ...]:
    """The ``most`` scored windows with the largest errors, the worst first."""
    floor = np.array([channel.noise_floor for channel in accepted_score.channels])
    windows = []
    for w in np.unique(accepted_score.window):
        rows = accepted_score.window == w
        ratio = float(np.mean(np.sqrt(np.mean(accepted_score.errors[rows] ** 2, axis=0)) / floor))
        times = record.t[accepted_score.rows[rows]]
        windows.append(WorstWindow(float(times[0]), float(times[-1]), ratio))
    return tuple(sorted(windows, key=lambda window: -window.ratio)[:most])


def _reasons(
    channels: tuple[ChannelVerdict, ...], values_p: float, changes: tuple[ValueChange, ...], level: float
) -> tuple[str, ...]:
    """A sentence for each test below its level."""
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
        listed = ", ".join(names) or "no single one beyond doubt, but a combination of them"
        reasons.append(f"Values have changed (p = {values_p:.2g}): {listed}.")
    return tuple(reasons)


def _notes(accepted: Accepted, model: Model) -> tuple[str, ...]:
    """A sentence on each item that the file of the accepted model lacks."""
    notes = []
    if accepted.covariance is None:
        notes.append(f"{accepted.name} holds no errors of its values: they are taken as exact.")
    if model.metric is Metric.INVERSE_DYNAMICS and not accepted.residual_ratio:
        notes.append(
            f"{accepted.name} does not say how well it fitted: the noise floor alone is the yardstick."
        )
    return tuple(notes)


__all__ = ["ALPHA", "ChannelVerdict", "ValueChange", "Verification", "WorstWindow", "verify"]
