"""The metric of the contract: windowed simulation with an unscored lead-in, and its noise floor."""

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
from labhil.physics.model import Metric, Model, Record
from labhil.signals import FloatArray, IntArray

PHASES = np.arange(16) / 16.0
"""Of a converter's steps, over which what its rounding leaves is averaged."""

ROUNDING = 1e-9
"""Of its size: a channel that varies by less is a constant."""


@dataclass(frozen=True, slots=True)
class ChannelScore:
    """How well one output is simulated: MSE in unit²; RMSE, largest error, floor in unit; R² a fraction.

    ``relative_error`` is RMSE over the RMS of what was measured, by inverse dynamics, where zero is no force.
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
    """Headline figures of some channels.

    ``beside`` are figures by another metric: they are shown, and enter no headline.
    """

    channels: tuple[ChannelScore, ...]
    beside: tuple[ChannelScore, ...] = field(default=(), kw_only=True)

    @property
    def reported(self) -> tuple[ChannelScore, ...]:
        """The scored channels, then the figures beside them."""
        return self.channels + self.beside

    @property
    def rmse(self) -> float:
        """The headline: in its unit with one channel, else mean of RMSE over floor."""
        if len(self.channels) == 1:
            return self.channels[0].rmse
        return float(np.mean([c.rmse / c.noise_floor for c in self.channels]))

    @property
    def mse(self) -> float:
        """The headline's mean square."""
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
        """RMSE over the noise floor, of the worst channel."""
        return max(c.rmse / c.noise_floor for c in self.channels)

    @property
    def noise_floor(self) -> float:
        """The figure that a perfect model would reach, initial-state error included."""
        return self.channels[0].noise_floor if len(self.channels) == 1 else 1.0


@dataclass(frozen=True, slots=True)
class RecordingScore(Figures):
    """The same on one of several recordings, by its number; ``places`` are its among the scored samples."""

    recording: int
    places: slice


@dataclass(frozen=True, slots=True)
class Score(Figures):
    """Errors (N, c), simulated − measured, of all scored samples; ``rows`` (N,) are their places.

    ``recordings`` are the figures of each recording, where there are several.
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
        """The score of one joint's output; the whole for None."""
        if joint is None:
            return self
        columns = [k for k, channel in enumerate(self.channels) if channel.joint == joint]
        channels, scores = tuple(self.channels[k] for k in columns), self.recordings
        recordings = tuple(replace(r, channels=tuple(r.channels[k] for k in columns)) for r in scores)
        return replace(self, channels=channels, errors=self.errors[:, columns], recordings=recordings)


def scored_horizon(model: Model, theta: FloatArray, record: Record) -> float:
    """The horizon of a model's metric, s; where it is longer than a recording, one that fits twice.

    A vector with hardly any damping has so long a horizon.
    """
    wanted = model.horizon_at(theta)
    return wanted if wanted <= min(record.durations) else record.countable


def score(
    model: Model,
    theta: FloatArray,
    record: Record,
    sigma: FloatArray,
    horizon: float | None = None,
    lasts: FloatArray | None = None,
    windows: ScoredWindows | None = None,
) -> Score:
    """Simulate the windows of a record, each from the state that its own lead-in suggests.

    ``sigma`` (channels,) is the measurement noise, and ``lasts`` (channels,) how many times the variance of a
    mean of white noise its mean has (default: 1); ``windows`` take the place of those that ``horizon`` cuts.
    Raises RecordingError when the record is too short.
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
        problem, windows, states, residuals, np.ones(c) if lasts is None else lasts
    )
    owner = windows.whole.owner[windows.scored]
    stated = None if model.metric is Metric.INVERSE_DYNAMICS else windows.horizon
    return Score(
        _channels(record, errors, rows, noise, carried, model.metric),
        errors,
        rows,
        owner,
        model.metric,
        stated,
        windows,
        states,
        _by_recording(record, errors, rows, noise, carried, model.metric),
    )


def with_forces(
    simulation_score: Score, model: Model, theta: FloatArray, record: Record, sigma: FloatArray
) -> Score:
    """The same score with inverse dynamics beside it, where the model can say what its drive had to push."""
    if not isinstance(model, HasInverseDynamics):
        return simulation_score
    try:
        forces = model.balance(theta, record)
    except RecordingError:  # hardly anything moves: there is nothing to show beside
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
    """The figures of errors (N,) beside what was measured (N,); ``name`` is channel, joint and unit.

    ``sst`` is the sum of squares about the mean of what was measured; of a constant there is no R².
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
        r2=1.0 - sse / sst if sst > len(errors) * (ROUNDING * size) ** 2 else float("nan"),
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


def _lasting_rounding(
    rounded: Sequence[Rounding | None], simulated: FloatArray, problem: Problem, phase: float
) -> FloatArray:
    """What of rounding lasts, over the noise, (N·c,), with all converters' steps shifted by a ``phase``.

    A floor is that of any device like this one, whose steps may lie elsewhere.
    """
    errors = np.zeros_like(simulated)
    for j, rounding in enumerate(rounded):
        if rounding is not None:
            errors[:, j] = rounding.lasting(simulated[:, j], phase)
    return np.asarray((errors / problem.noise).ravel())


def _state_error_variance(
    problem: Problem, windows: ScoredWindows, states: FloatArray, residuals: FloatArray, lasts: FloatArray
) -> FloatArray:
    """What the initial state's error adds to the variance of each scored sample (N, c), over the noise's.

    a·(AᵀA)⁻¹·AᵀLA·(AᵀA)⁻¹·aᵀ, A over the lead-in, a over the scored part, L how long noise lasts; the noise
    floor is σ·√(1 + its mean). What of rounding lasts goes through the same by itself, and so does what the
    noise of a measured input makes of the simulation, beside that itself.
    """
    c = len(problem.sigma)
    point = Point(np.empty(0), states)
    lin = problem.linearise(point, residuals)
    lead = lin.by_states * np.repeat(~windows.scored, c)[:, None]
    inverse = np.linalg.inv(problem.state_gram(lead))
    rounded = [Rounding.of(problem.record.outputs[:, j], problem.sigma[j]) for j in range(c)]
    apart = np.array([1.0 - rounding.share if rounding is not None else 1.0 for rounding in rounded])
    lasting = problem.state_gram(lead * np.tile(np.sqrt(lasts * apart), len(lead) // c)[:, None])
    spread = (inverse @ lasting @ inverse)[problem.owner]
    carried = np.einsum("ns,nst,nt->n", lin.by_states, spread, lin.by_states)
    if np.any(apart < 1.0):
        simulated = problem.record.outputs[problem.windows.rows] + residuals.reshape(-1, c) * problem.noise
        errors = [_lasting_rounding(rounded, simulated, problem, phase) for phase in PHASES]
        moved = [(inverse @ problem.products(lead, error[:, None]))[:, :, 0] for error in errors]
        along = [np.sum(lin.by_states * shift[problem.owner], axis=1) for shift in moved]
        carried += np.mean(np.square(along), axis=0)
    # a state that its lead-in cannot see (a ball that rests there) stays where it was put
    carried = np.minimum(carried, 100.0)
    changes = responses_to_input_noise(problem, point)
    if changes.size:
        shifts = inverse @ problem.products(lead, changes)
        remaining = without_states(changes, lin.by_states, shifts, problem.edges)
        carried += np.mean(remaining**2, axis=1)
    return np.asarray(carried.reshape(-1, c)[windows.scored])
