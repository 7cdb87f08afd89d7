"""Compare all baselines on a recording: fitted to one part, scored on another, a row for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from labhil.errors import RecordingError
from labhil.identify.linear.baselines import BASELINES, fit_linear
from labhil.identify.linear.data import Figures, LinearModel, Orders, Sampled, figures_of
from labhil.physics.record import Record
from labhil.signals import FloatArray, Hold


@dataclass(frozen=True, slots=True)
class LinearRow:
    """One baseline on one output: the model, and the errors of its free run on ``train`` and ``test``."""

    channel: str
    unit: str
    model: LinearModel
    train: Figures
    test: Figures


def linear_study(
    train: Record,
    test: Record,
    names: Sequence[str] | None = None,
    orders: Orders | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[LinearRow]:
    """Fit baselines to training data and simulate them freely over test data.

    A simulation starts in the state that fits best (of NARX the measured one), and uses nothing else of the
    output.

    Args:
        train: Training data, with one input; each output is modelled by itself.
        test: Test data of the same channels.
        names: Of the baselines; by default all.
        orders: How large they are; by default chosen from the training data.
        progress: Called with a line of text before each fit.

    Returns:
        A row for each output and baseline.

    Raises:
        UnknownNameError: There is no such baseline.
        RecordingError: Several inputs, too few samples, or a constant input.
    """
    if train.inputs.shape[1] != 1:
        inputs = ", ".join(train.input_names)
        raise RecordingError(f"a linear baseline takes one input, found {train.inputs.shape[1]}: {inputs}")
    rows = []
    for j, channel in enumerate(train.output_names):
        fitted = resample_evenly(train, j)
        held_out = resample_evenly(test, j, fitted.period)
        for name in names if names is not None else BASELINES:
            progress(f"{name}: {channel}")
            model = fit_linear(name, fitted.u, fitted.y, fitted.period, orders, fitted.hold)
            figures = _figures(model, fitted), _figures(model, held_out)
            rows.append(LinearRow(channel, train.output_units[j], model, *figures))
    return rows


def study_text(rows: Sequence[LinearRow]) -> list[str]:
    """Write the rows as lines of a table, errors in the channel's unit, then each model as an equation."""
    lines = [
        f"{'model':<20}{'output':<18}{'param.':>6}  {'RMSE train':>11}{'test':>11}"
        f"{'R² train':>10}{'test':>9}{'max. test':>12}"
    ]
    for row in rows:
        name = f"{row.channel} [{row.unit}]"
        lines.append(
            f"{row.model.name:<20}{name:<18}{len(row.model.parameters):>6}  "
            f"{row.train.rmse:>11.4g}{row.test.rmse:>11.4g}"
            f"{row.train.r2:>10.4f}{row.test.r2:>9.4f}{row.test.max_abs_error:>12.4g}"
        )
    return [*lines, "", *(f"{row.model.name}: {row.model.describe()}" for row in rows)]


def study_json(rows: Sequence[LinearRow]) -> list[dict[str, Any]]:
    """Convert the rows to plain data for JSON; numbers that are not finite become None."""
    return [
        {
            "model": row.model.name,
            "channel": row.channel,
            "unit": row.unit,
            "orders": asdict(row.model.orders),
            "parameters": {name: _finite_or_none(value) for name, value in row.model.parameters.items()},
            "poles": [[float(pole.real), float(pole.imag)] for pole in row.model.poles],
            "equation": row.model.describe(),
            "train": {name: _finite_or_none(value) for name, value in asdict(row.train).items()},
            "test": {name: _finite_or_none(value) for name, value in asdict(row.test).items()},
        }
        for row in rows
    ]


def resample_evenly(
    record: Record, j: int, period: float | None = None, *, max_jitter: float = 0.2
) -> Sampled:
    """Take the input and one output of a record at even times; resample them where needed.

    Between samples an output is interpolated linearly, an input as its hold says.

    Args:
        record: With one input.
        j: Index of the output.
        period: Sampling period, s; by default the record's median.
        max_jitter: Share of a period by which samples may lie off an even grid without being resampled.
    """
    step = record.period if period is None else period
    hold = record.input_holds[0]
    t, u, y = record.t, record.inputs[:, 0], record.outputs[:, j]
    grid = t[0] + step * np.arange(int(np.floor((t[-1] - t[0]) / step + 0.5)) + 1)
    if len(grid) == len(t) and float(np.max(np.abs(grid - t))) <= max_jitter * step:
        return Sampled(np.ascontiguousarray(u), np.ascontiguousarray(y), step, hold)
    return Sampled(_resample(grid, t, u, hold), np.interp(grid, t, y), step, hold)


def _resample(grid: FloatArray, t: FloatArray, values: FloatArray, hold: Hold) -> FloatArray:
    """Values (m,) at the times ``grid`` (m,) of an input with this hold."""
    if hold is Hold.LINEAR:
        return np.interp(grid, t, values)
    before = np.searchsorted(t, grid + 1e-9 * (t[1] - t[0]), side="right") - 1
    return np.asarray(values[np.maximum(before, 0)])


def _figures(model: LinearModel, data: Sampled) -> Figures:
    """Errors of the model's free run over the data."""
    return figures_of(data.y, model.simulate(data.u, data.y))


def _finite_or_none(value: float) -> float | None:
    """A number for JSON."""
    return float(value) if np.isfinite(value) else None
