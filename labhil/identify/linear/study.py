"""All baselines on a recording: fitted to one part, judged on another, a row for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from labhil.errors import RecordingError
from labhil.identify.linear.baselines import BASELINES, fit_linear
from labhil.identify.linear.data import Figures, LinearModel, Orders, Sampled, figures_of
from labhil.physics.model import Record
from labhil.signals import FloatArray, Hold

UNEVEN = 0.2
"""Share of a period by which samples may lie off an even grid before they are put onto one."""


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
    """Fit the baselines ``names`` (all when None) to ``train`` and run them freely over ``test``.

    Each output of the record is one study. A run begins in the state that suits it best (NARX: in the
    measured one), and uses nothing else of the output. ``orders`` None: chosen from the data.
    Raises UnknownNameError and RecordingError (several inputs, too few samples, a constant input).
    """
    if train.inputs.shape[1] != 1:
        inputs = ", ".join(train.input_names)
        raise RecordingError(f"a linear baseline takes one input, found {train.inputs.shape[1]}: {inputs}")
    rows = []
    for j, channel in enumerate(train.output_names):
        learn = evenly(train, j)
        judge = evenly(test, j, learn.period)
        for name in names if names is not None else BASELINES:
            progress(f"{name}: {channel}")
            model = fit_linear(name, learn.u, learn.y, learn.period, orders, learn.hold)
            rows.append(
                LinearRow(channel, train.output_units[j], model, _judge(model, learn), _judge(model, judge))
            )
    return rows


def study_text(rows: Sequence[LinearRow]) -> list[str]:
    """The rows as lines of a table, errors in the channel's unit, then each model as an equation."""
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
    """The rows as plain data; what is not finite is None."""
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


def evenly(record: Record, j: int, period: float | None = None) -> Sampled:
    """Input and output ``j`` of a record every ``period`` s (its own median), put onto a grid where needed.

    Between samples an output is taken to run straight, an input to do what it does.
    """
    step = record.period if period is None else period
    hold = record.input_holds[0]
    t, u, y = record.t, record.inputs[:, 0], record.outputs[:, j]
    grid = t[0] + step * np.arange(int(np.floor((t[-1] - t[0]) / step + 0.5)) + 1)
    if len(grid) == len(t) and float(np.max(np.abs(grid - t))) <= UNEVEN * step:
        return Sampled(np.ascontiguousarray(u), np.ascontiguousarray(y), step, hold)
    return Sampled(_resample(grid, t, u, hold), np.interp(grid, t, y), step, hold)


def _resample(grid: FloatArray, t: FloatArray, values: FloatArray, hold: Hold) -> FloatArray:
    if hold is Hold.LINEAR:
        return np.interp(grid, t, values)
    before = np.searchsorted(t, grid + 1e-9 * (t[1] - t[0]), side="right") - 1
    return np.asarray(values[np.maximum(before, 0)])


def _judge(model: LinearModel, data: Sampled) -> Figures:
    return figures_of(data.y, model.simulate(data.u, data.y))


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
