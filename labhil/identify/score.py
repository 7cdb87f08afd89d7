"""Score a model: errors of windowed simulation with an unscored lead-in, and the noise floor.

``labhil.identify.windows`` cuts the windows; ``adequacy`` decides from scores whether a model explains its
data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labhil.errors import RecordingError
from labhil.identify.input_noise import responses_to_input_noise
from labhil.identify.problem import Point, Problem
from labhil.identify.rounding import Rounding
from labhil.identify.window_products import without_states
from labhil.identify.window_states import estimate_states_at
from labhil.identify.windows import ScoredWindows, noise_at, scored_windows, whole_recordings
from labhil.physics.drive_balance import HasInverseDynamics
from labhil.physics.model import Metric, Model
from labhil.physics.record import Record
from labhil.signals import FloatArray, IntArray

QUANTISER_PHASES = np.arange(16) / 16.0
"""Positions of a converter's steps over which the error of its rounding is averaged."""

MIN_RELATIVE_SPREAD = 1e-9
"""Standard deviation over RMS below which a channel counts as constant (machine precision)."""


@dataclass(frozen=True, slots=True)
class ChannelScore:
    """Errors of one output.

    Attributes:
        channel: Name of the output.
        joint: Joint of an arm; None for others.
        unit: Of the output.
        mse: Mean squared error, unit².
        rmse: Its root, unit.
        max_abs_error: Largest absolute error, unit.
        r2: 1 − SSE/SST, a fraction; NaN of a constant output.
        noise_floor: RMSE of a perfect model, initial-state error included, unit.
        metric: How the output was computed.
        relative_error: RMSE over RMS of the measured forces, of inverse dynamics only, where zero is no
            force.
    """

    channel: str
    joint: int | None
    unit: str
    mse: float
    rmse: float
    max_abs_error: float
    r2: float
    noise_floor: float
    metric: Metric = Metric.WINDOWED_SIMULATION
    relative_error: float | None = None


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures over some channels.

    Attributes:
        channels: The scored channels.
        beside: Scores by another metric, which are reported but do not enter the figures.
    """

    channels: tuple[ChannelScore, ...]
    beside: tuple[ChannelScore, ...] = field(default=(), kw_only=True)

    @property
    def reported(self) -> tuple[ChannelScore, ...]:
        """The scored channels, then those by another metric."""
        return self.channels + self.beside

    @property
    def rmse(self) -> float:
        """RMSE, in its unit, of a single channel; of several the mean of RMSE over noise floor."""
        if len(self.channels) == 1:
            return self.channels[0].rmse
        return float(np.mean([c.rmse / c.noise_floor for c in self.channels]))

    @property
    def mse(self) -> float:
        """MSE, in its unit, of a single channel; of several the mean of MSE over squared noise floor."""
        if len(self.channels) == 1:
            return self.channels[0].mse
        return float(np.mean([c.mse / c.noise_floor**2 for c in self.channels]))

    @property
    def r2(self) -> float:
        """Mean R² of the channels."""
        return float(np.mean([c.r2 for c in self.channels]))

    @property
    def max_abs_error(self) -> float:
        """Largest absolute error of any channel."""
        return max(c.max_abs_error for c in self.channels)

    @property
    def excess(self) -> float:
        """Largest RMSE over noise floor of any channel."""
        return max(c.rmse / c.noise_floor for c in self.channels)

    @property
    def noise_floor(self) -> float:
        """The ``rmse`` of a perfect model, initial-state error included."""
        return self.channels[0].noise_floor if len(self.channels) == 1 else 1.0


@dataclass(frozen=True, slots=True)
class RecordingScore(Figures):
    """Figures of one of several recordings.

    Attributes:
        recording: Its number.
        places: Its samples among the scored ones.
    """

    recording: int
    places: slice


@dataclass(frozen=True, slots=True)
class Score(Figures):
    """Figures and errors of a model on a record.

    Attributes:
        errors: (N, c) simulated − measured of all scored samples, in the channels' units.
        rows: (N,) rows of these samples in the record.
        window: (N,) index of the window that each belongs to.
        metric: How outputs were computed.
        horizon: Length of the scored part of a window, s; None of inverse dynamics.
        windows: The windows.
        states: (W, S) initial states.
        recordings: Figures of each recording, where there are several.
    """

    errors: FloatArray
    rows: IntArray
    window: IntArray
    metric: Metric
    horizon: float | None
    windows: ScoredWindows
    states: FloatArray
    recordings: tuple[RecordingScore, ...] = ()

    def of_joint(self, joint: int | None) -> Score:
        """The score of one joint's output; of all outputs for None."""
        if joint is None:
            return self
        columns = [k for k, channel in enumerate(self.channels) if channel.joint == joint]
        channels, scores = tuple(self.channels[k] for k in columns), self.recordings
        recordings = tuple(replace(r, channels=tuple(r.channels[k] for k in columns)) for r in scores)
        return replace(self, channels=channels, errors=self.errors[:, columns], recordings=recordings)


def scored_horizon(model: Model, theta: FloatArray, record: Record) -> float:
    """Horizon (s) by which a model is scored on a record.

    It is the model's own, or where that is longer than a recording (with hardly any damping), one that fits
    into it twice.
    """
    wanted = model.horizon_at(theta)
    return wanted if wanted <= min(record.durations) else record.max_horizon


def score(
    model: Model,
    theta: FloatArray,
    record: Record,
    sigma: FloatArray,
    horizon: float | None = None,
    variance_inflation: FloatArray | None = None,
    windows: ScoredWindows | None = None,
) -> Score:
    """Simulate the windows of a record, each from a state that is estimated from its lead-in, and score them.

    Args:
        model: What is simulated.
        theta: Its parameter vector.
        record: What was measured.
        sigma: (c,) standard deviation of each channel's noise, in its unit.
        horizon: Length of the scored part of a window, s; by default :func:`scored_horizon`.
        variance_inflation: (c,) variance of the noise's mean over that of white noise; by default 1.
        windows: Windows to use instead of those that ``horizon`` gives.

    Raises:
        RecordingError: The record is too short.
    """
    if model.metric is Metric.INVERSE_DYNAMICS:
        windows = whole_recordings(record)
    elif windows is None:
        windows = scored_windows(record, horizon or scored_horizon(model, theta, record))
    no_parameters = np.empty(0, dtype=np.int64)
    states = estimate_states_at(model, theta, record, windows.lead, sigma, thorough=True).states
    problem = Problem(model, record, windows.whole, no_parameters, theta, sigma)
    residuals = problem.residuals(Point(np.empty(0), states))
    c = record.outputs.shape[1]
    rows = windows.whole.rows[windows.scored]
    noise = noise_at(record, rows, sigma)
    errors = residuals.reshape(-1, c)[windows.scored] * noise
    carried = _state_error_variance(
        problem, windows, states, residuals, np.ones(c) if variance_inflation is None else variance_inflation
    )
    owner = windows.whole.owner[windows.scored]
    reported_horizon = None if model.metric is Metric.INVERSE_DYNAMICS else windows.horizon
    return Score(
        _channels(record, errors, rows, noise, carried, model.metric),
        errors,
        rows,
        owner,
        model.metric,
        reported_horizon,
        windows,
        states,
        _by_recording(record, errors, rows, noise, carried, model.metric),
    )


def with_forces(
    simulation_score: Score, model: Model, theta: FloatArray, record: Record, sigma: FloatArray
) -> Score:
    """Add the error of the drive's force by inverse dynamics to a score, where the model has it.

    Args:
        simulation_score: By windowed simulation.
        model: Unchanged score unless it ``HasInverseDynamics``.
        theta: Its parameter vector.
        record: What was measured.
        sigma: (c,) standard deviation of each channel's noise, in its unit.
    """
    if not isinstance(model, HasInverseDynamics):
        return simulation_score
    try:
        forces = model.balance(theta, record)
    except RecordingError:  # hardly anything moves
        return simulation_score
    errors = forces.needed - forces.exerted
    spread = float(np.sum((forces.exerted - forces.exerted.mean()) ** 2))
    name, floor = ("drive_force", None, "N"), float(sigma[0]) * forces.noise
    row = _row(name, errors, forces.exerted, spread, floor, Metric.INVERSE_DYNAMICS)
    return replace(simulation_score, beside=(row,))


def _by_recording(
    record: Record,
    errors: FloatArray,
    rows: IntArray,
    noise: FloatArray,
    carried: FloatArray,
    metric: Metric,
) -> tuple[RecordingScore, ...]:
    """Figures of each recording; none where there is only one."""
    if len(record.begins) == 1:
        return ()
    scores = []
    for begin, (first, last) in zip(record.begins, record.spans, strict=True):
        places = slice(*np.searchsorted(rows, [first, last]).tolist())
        noise_here = noise if noise.ndim == 1 else noise[places]
        channels = _channels(record, errors[places], rows[places], noise_here, carried[places], metric)
        scores.append(RecordingScore(channels, begin.number, places))
    return tuple(scores)


def _channels(
    record: Record,
    errors: FloatArray,
    rows: IntArray,
    noise: FloatArray,
    carried: FloatArray,
    metric: Metric,
) -> tuple[ChannelScore, ...]:
    """How well each output is simulated at these rows (N,); ``noise`` is (c,), or (N, c) by recording.

    ``carried`` (N, c) is as of :func:`_state_error_variance`.
    """
    # the noise floor: the RMSE of a perfect model
    if noise.ndim == 1:
        floor = np.asarray(noise * np.sqrt(1.0 + carried.mean(axis=0)))
    else:
        floor = np.asarray(np.sqrt(np.mean(noise**2 * (1.0 + carried), axis=0)))
    return tuple(
        _row(
            (*record.channel(j), record.output_units[j]), errors[:, j], record.outputs[rows, j],
            _spread(record, j, rows), floor[j], metric,
        )
        for j in range(errors.shape[1])
    )  # fmt: skip


def _row(
    name: tuple[str, int | None, str],
    errors: FloatArray,
    measured: FloatArray,
    sst: float,
    floor: float,
    metric: Metric,
) -> ChannelScore:
    """The figures of errors (N,) of a measured output (N,); ``name`` is channel, joint and unit.

    ``sst`` is the sum of squares of the measured output about its mean; a constant output has no R².
    """
    sse = float(errors @ errors)
    rmse, size = float(np.sqrt(sse / len(errors))), float(np.sqrt(np.mean(measured**2)))
    channel, joint, unit = name
    return ChannelScore(
        channel=channel,
        joint=joint,
        unit=unit,
        mse=sse / len(errors),
        rmse=rmse,
        max_abs_error=float(np.abs(errors).max()),
        r2=1.0 - sse / sst if sst > len(errors) * (MIN_RELATIVE_SPREAD * size) ** 2 else float("nan"),
        noise_floor=float(floor),
        metric=metric,
        relative_error=rmse / size if metric is Metric.INVERSE_DYNAMICS and size > 0 else None,
    )


def _spread(record: Record, j: int, rows: IntArray) -> float:
    """Sum of squares of an output about its mean in each recording: one does not explain where another is."""
    total = 0.0
    for first, last in record.spans:
        measured = record.outputs[rows[slice(*np.searchsorted(rows, [first, last]).tolist())], j]
        if len(measured):
            total += float(np.sum((measured - measured.mean()) ** 2))
    return total


def _mean_rounding_errors(
    roundings: Sequence[Rounding | None], simulated: FloatArray, problem: Problem, phase: float
) -> FloatArray:
    """Mean quantisation errors (N·c,) in units of noise, with all converters' steps shifted by a ``phase``.

    The noise floor is that of any device of this kind, whose steps may lie elsewhere.
    """
    errors = np.zeros_like(simulated)
    for j, rounding in enumerate(roundings):
        if rounding is not None:
            errors[:, j] = rounding.mean_error(simulated[:, j], phase)
    return np.asarray((errors / problem.noise).ravel())


def _state_error_variance(
    problem: Problem,
    windows: ScoredWindows,
    states: FloatArray,
    residuals: FloatArray,
    variance_inflation: FloatArray,
) -> FloatArray:
    """Variance (N, c) that errors of the initial state add to each scored sample, in units of the noise's.

    It is a·(AᵀA)⁻¹·AᵀLA·(AᵀA)⁻¹·aᵀ, with slopes A by the state over the lead-in, a over the scored part, and
    the variance inflation L of coloured noise. The noise floor is σ·√(1 + its mean). Mean quantisation errors
    and the noise of a measured input enter the estimated state in the same way; the latter also enters the
    simulation itself.
    """
    c = len(problem.sigma)
    point = Point(np.empty(0), states)
    lin = problem.linearise(point, residuals)
    lead = lin.by_states * np.repeat(~windows.scored, c)[:, None]
    inverse = np.linalg.inv(problem.state_gram(lead))
    roundings = [Rounding.of(problem.record.outputs[:, j], problem.sigma[j]) for j in range(c)]
    independent = np.array([1.0 - rounding.share if rounding is not None else 1.0 for rounding in roundings])
    weights = np.sqrt(variance_inflation * independent)
    inflated = problem.state_gram(lead * np.tile(weights, len(lead) // c)[:, None])
    covariance = (inverse @ inflated @ inverse)[problem.owner]
    carried = np.einsum("ns,nst,nt->n", lin.by_states, covariance, lin.by_states)
    if np.any(independent < 1.0):
        simulated = problem.record.outputs[problem.windows.rows] + residuals.reshape(-1, c) * problem.noise
        errors = [_mean_rounding_errors(roundings, simulated, problem, phase) for phase in QUANTISER_PHASES]
        shifts = [(inverse @ problem.products(lead, error[:, None]))[:, :, 0] for error in errors]
        effects = [np.sum(lin.by_states * shift[problem.owner], axis=1) for shift in shifts]
        carried += np.mean(np.square(effects), axis=0)
    # a state that has no effect in its lead-in (a ball that rests there) would have an infinite error
    carried = np.minimum(carried, 100.0)
    changes = responses_to_input_noise(problem, point)
    if changes.size:
        input_shifts = inverse @ problem.products(lead, changes)
        remaining = without_states(changes, lin.by_states, input_shifts, problem.edges)
        carried += np.mean(remaining**2, axis=1)
    return np.asarray(carried.reshape(-1, c)[windows.scored])
