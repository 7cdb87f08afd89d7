"""The metric of the contract: windowed simulation with an unscored lead-in, and its noise floor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labhil.errors import RecordingError
from labhil.identify.least_squares import fit_states, rescue_states
from labhil.identify.problem import Point, Problem
from labhil.identify.windows import ScoredWindows, all_of, scored_windows
from labhil.physics.drive_balance import Balanced
from labhil.physics.model import Metric, Model, Record
from labhil.signals import FloatArray, IntArray


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
class Score:
    """Errors (N, c), simulated − measured, of all scored samples; ``rows`` (N,) are their places.

    ``beside`` are figures by another metric: they are shown, and enter no headline.
    """

    channels: tuple[ChannelScore, ...]
    errors: FloatArray
    rows: IntArray
    window: IntArray
    metric: Metric
    horizon: float | None
    windows: ScoredWindows
    states: FloatArray
    beside: tuple[ChannelScore, ...] = ()

    @property
    def rows_told(self) -> tuple[ChannelScore, ...]:
        """All that is reported: the scored channels, then what stands beside them."""
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
    def noise_floor(self) -> float:
        """The figure that a perfect model would reach, initial-state error included."""
        return self.channels[0].noise_floor if len(self.channels) == 1 else 1.0


def score(
    model: Model, theta: FloatArray, record: Record, sigma: FloatArray, horizon: float | None = None
) -> Score:
    """Simulate the windows of a record, each from the state that its own lead-in suggests.

    ``sigma`` (channels,) is the measurement noise. Raises RecordingError when the record is too short.
    """
    if model.metric is Metric.INVERSE_DYNAMICS:
        windows = all_of(record)
    else:
        windows = scored_windows(record, horizon or model.horizon_at(theta))
    nothing = np.empty(0, dtype=np.int64)
    lead = Problem(model, record, windows.lead, nothing, theta, sigma)
    none = np.empty(0)
    states = rescue_states(lead, none, fit_states(lead, none, model.initial_states(record, windows.lead)))
    whole = Problem(model, record, windows.whole, nothing, theta, sigma)
    residuals = whole.residuals(Point(np.empty(0), states))
    c = record.outputs.shape[1]
    errors = residuals.reshape(-1, c)[windows.scored] * sigma
    rows = windows.whole.rows[windows.scored]
    floor = _noise_floor(whole, windows, states, residuals, sigma)
    channels = tuple(
        _channel(record, j, errors[:, j], record.outputs[rows, j], floor[j], model.metric) for j in range(c)
    )
    owner = windows.whole.owner[windows.scored]
    stated = None if model.metric is Metric.INVERSE_DYNAMICS else windows.horizon
    return Score(channels, errors, rows, owner, model.metric, stated, windows, states)


def with_forces(found: Score, model: Model, theta: FloatArray, record: Record, sigma: FloatArray) -> Score:
    """The same score with inverse dynamics beside it, where the model can say what its drive had to push."""
    if not isinstance(model, Balanced):
        return found
    try:
        forces = model.balance(theta, record)
    except RecordingError:  # hardly anything moves: there is nothing to show beside
        return found
    errors = forces.needed - forces.exerted
    floor = float(sigma[0]) * forces.noise
    row = _row(("drive_force", None, "N"), errors, forces.exerted, floor, Metric.INVERSE_DYNAMICS)
    return replace(found, beside=(row,))


def _channel(
    record: Record, j: int, errors: FloatArray, measured: FloatArray, floor: float, metric: Metric
) -> ChannelScore:
    return _row((*record.channel(j), record.output_units[j]), errors, measured, floor, metric)


def _row(
    name: tuple[str, int | None, str], errors: FloatArray, measured: FloatArray, floor: float, metric: Metric
) -> ChannelScore:
    """The figures of errors (N,) beside what was measured (N,); ``name`` is channel, joint and unit."""
    sse = float(errors @ errors)
    sst = float(np.sum((measured - measured.mean()) ** 2))
    rmse, size = float(np.sqrt(sse / len(errors))), float(np.sqrt(np.mean(measured**2)))
    channel, joint, unit = name
    return ChannelScore(
        channel=channel,
        joint=joint,
        unit=unit,
        mse=sse / len(errors),
        rmse=rmse,
        max_abs_error=float(np.abs(errors).max()),
        r2=1.0 - sse / sst if sst > 0 else float("nan"),
        noise_floor=float(floor),
        metric=metric,
        relative_error=rmse / size if metric is Metric.INVERSE_DYNAMICS and size > 0 else None,
    )


def _noise_floor(
    whole: Problem, windows: ScoredWindows, states: FloatArray, residuals: FloatArray, sigma: FloatArray
) -> FloatArray:
    """RMSE of a perfect model: σ·√(1 + mean of a·(AᵀA)⁻¹·aᵀ), A over the lead-in, a over the scored part."""
    c = len(sigma)
    lin = whole.linearise(Point(np.empty(0), states), residuals)
    lead_rows = np.repeat(~windows.scored, c)[:, None]
    gram = whole.state_gram(lin.by_states * lead_rows)
    spread = np.linalg.inv(gram)[whole.owner]
    carried = np.einsum("ns,nst,nt->n", lin.by_states, spread, lin.by_states)
    # a state that its lead-in cannot see (a ball that rests there) stays where it was put
    carried = np.minimum(carried, 100.0).reshape(-1, c)[windows.scored]
    return np.asarray(sigma * np.sqrt(1.0 + carried.mean(axis=0)))
