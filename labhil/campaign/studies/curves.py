"""Curves of a result's figures, thinned, in a file beside its JSON.

An array ``CHANNEL/NAME`` per output channel: ``t`` (s), ``measured``, and ``before`` / ``after`` (simulated
windows, NaN where a new window begins); ``missing/TERM`` is the contribution of a missing term over
``missing/TERM/x``. A fit has only ``after``.
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
    from labhil.physics.record import Record

MAX_POINTS = 20_000
"""Points of a channel; more than any terminal has columns."""
MAX_DOTS = 2_000
"""Points of a contribution."""


def curves_of_fit(result: FitResult) -> dict[str, Any]:
    """Return the curves of a fit, on its test data or else its training data."""
    score = result.fit.test or result.fit.train
    record = result.dataset.test if result.fit.test is not None else result.dataset.train
    return _channels(record, {"after": score})


def curves_of_diagnosis(result: DiagnosisResult) -> dict[str, Any]:
    """Return the curves of a diagnosis: baseline and final model on test data, and missing terms."""
    from labhil.diagnose import locate

    diagnosis = result.diagnosis
    curves = _channels(result.dataset.test, {"before": diagnosis.before, "after": diagnosis.after})
    for key in diagnosis.named:
        contribution = locate.contribution(diagnosis.final_fit, key)
        abscissa = contribution.abscissa(contribution.regimes())
        x, y = abscissa.x, np.asarray(contribution.values)
        step = max(1, len(x) // MAX_DOTS)
        curves[f"missing/{key}"] = y[::step].astype(np.float32)
        curves[f"missing/{key}/x"] = x[::step].astype(np.float32)
        curves[f"missing/{key}/axis"] = np.array(abscissa.label)
    return curves


def _channels(record: Record, scores: dict[str, Score]) -> dict[str, Any]:
    curves: dict[str, Any] = {}
    first = next(iter(scores.values()))
    for j, channel in enumerate(first.channels):
        name = keyed(channel.channel, channel.joint)
        rows = first.rows
        step = max(1, len(rows) // MAX_POINTS)
        measured = record.outputs[rows, j]
        curves[f"{name}/t"] = record.t[rows][::step].astype(np.float32)
        curves[f"{name}/measured"] = measured[::step].astype(np.float32)
        curves[f"{name}/unit"] = np.array(channel.unit)
        for label, score in scores.items():
            window_begins = np.r_[True, np.diff(score.window) > 0]
            simulated = np.where(window_begins, np.nan, measured + score.errors[:, j])[::step]
            curves[f"{name}/{label}"] = simulated.astype(np.float32)
    return curves


def read_curves(result: Path) -> dict[str, FloatArray]:
    """Read the curves beside a result's JSON; empty where there are none."""
    path = result.with_suffix(".npz")
    try:
        with np.load(path, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except (OSError, ValueError):
        return {}
