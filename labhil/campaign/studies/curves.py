"""What the pictures of a result are made of: numbers small enough to keep beside its JSON.

An entry ``CHANNEL/NAME`` per output channel: ``t`` (s), ``measured``, and ``before`` / ``after`` (simulated
windows, NaN where a new window begins); ``missing/TERM`` for what a missing term contributes, over
``missing/TERM/x``. A fit has ``after`` alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labhil.physics.terms import keyed
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.analysis.study import DiagnosisResult, FitResult
    from labhil.identify.score import Score
    from labhil.physics.model import Record

MOST_POINTS = 20_000
"""Of a channel; more than any terminal has columns."""
MOST_DOTS = 2_000


def curves_of_fit(result: FitResult) -> dict[str, Any]:
    """The curves of a fit, on the data that it is judged on."""
    score = result.fit.test or result.fit.train
    record = result.material.test if result.fit.test is not None else result.material.train
    return _channels(record, {"after": score})


def curves_of_diagnosis(result: DiagnosisResult) -> dict[str, Any]:
    """The curves of a diagnosis: before and after on data that the search never saw, and what is missing."""
    from labhil.diagnose import locate

    diagnosis = result.diagnosis
    curves = _channels(result.material.test, {"before": diagnosis.before, "after": diagnosis.after})
    for key in diagnosis.named:
        share = locate.contribution(diagnosis.final_fit, key)
        over = share.abscissa(share.regimes())
        x, y = over.x, np.asarray(share.values)
        step = max(1, len(x) // MOST_DOTS)
        curves[f"missing/{key}"] = y[::step].astype(np.float32)
        curves[f"missing/{key}/x"] = x[::step].astype(np.float32)
        curves[f"missing/{key}/axis"] = np.array(over.label)
    return curves


def _channels(record: Record, scores: dict[str, Score]) -> dict[str, Any]:
    curves: dict[str, Any] = {}
    first = next(iter(scores.values()))
    for j, channel in enumerate(first.channels):
        name = keyed(channel.channel, channel.joint)
        rows = first.rows
        step = max(1, len(rows) // MOST_POINTS)
        measured = record.outputs[rows, j]
        curves[f"{name}/t"] = record.t[rows][::step].astype(np.float32)
        curves[f"{name}/measured"] = measured[::step].astype(np.float32)
        curves[f"{name}/unit"] = np.array(channel.unit)
        for label, score in scores.items():
            new = np.r_[True, np.diff(score.window) > 0]
            simulated = np.where(new, np.nan, measured + score.errors[:, j])[::step]
            curves[f"{name}/{label}"] = simulated.astype(np.float32)
    return curves


def read_curves(result: Path) -> dict[str, FloatArray]:
    """The curves beside a result's JSON; empty where there are none."""
    path = result.with_suffix(".npz")
    try:
        with np.load(path, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except (OSError, ValueError):
        return {}
