"""From trials to the figures that are promised: errors in bounds, coverage, decisions, the noise ceiling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.campaign.proportion import Proportion
from labhil_benchmarks.statistics.trial import Case, Row, Trial

NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal deviate."""


@dataclass(frozen=True, slots=True)
class ParameterSummary:
    """One parameter over all trials.

    ``ratio`` is the median absolute error over that of a normal error as large as the Cramér-Rao bound;
    ``bias`` the mean error in bounds with its own standard error ``bias_error``.
    """

    key: str
    trials: int
    ratio: float
    bias: float
    bias_error: float
    coverage: Proportion


@dataclass(frozen=True, slots=True)
class Summary:
    """All figures of one case under one kind of noise."""

    case: str
    coloured: bool
    trials: int
    parameters: tuple[ParameterSummary, ...]
    pooled: Proportion
    absent_kept: Proportion
    present_kept: Proportion
    declared: Proportion
    never_narrow: Proportion
    r2_gap: float
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """As plain JSON data."""
        return asdict(self)


def summarise(case: Case, trials: Sequence[Trial]) -> Summary:
    """Count; ``trials`` are those of one case under one kind of noise."""
    known = [key for key in case.truth if key not in case.unknown]
    rows: dict[str, list[Row]] = {key: [] for key in known}
    for trial in trials:
        for row in trial.rows:
            if row.key in rows:
                rows[row.key].append(row)
    summaries = tuple(_parameter(key, entries) for key, entries in rows.items() if entries)
    unknown = [row for trial in trials for row in trial.rows if row.key in case.unknown]
    return Summary(
        case=case.name,
        coloured=trials[0].coloured,
        trials=len(trials),
        parameters=summaries,
        pooled=_total([p.coverage for p in summaries]),
        absent_kept=_absent_kept(trials),
        present_kept=_present_kept(trials, case),
        declared=Proportion(sum(not row.identifiable for row in unknown), len(unknown)),
        never_narrow=Proportion(sum(not row.identifiable or _covers(row) for row in unknown), len(unknown)),
        r2_gap=float(np.median([trial.r2_truth - trial.r2 for trial in trials])),
        seconds=float(np.median([trial.seconds for trial in trials])),
    )


def _parameter(key: str, rows: Sequence[Row]) -> ParameterSummary:
    errors = np.array([(row.value - row.truth) / row.bound for row in rows])
    return ParameterSummary(
        key=key,
        trials=len(rows),
        ratio=float(np.median(np.abs(errors)) / NORMAL_MEDIAN),
        bias=float(errors.mean()),
        bias_error=float(errors.std() / np.sqrt(len(errors))),
        coverage=Proportion(sum(_covers(row) for row in rows), len(rows)),
    )


def _covers(row: Row) -> bool:
    return row.low <= row.truth <= row.high


def _total(shares: Sequence[Proportion]) -> Proportion:
    return Proportion(sum(s.hits for s in shares), sum(s.total for s in shares))


def _absent_kept(trials: Sequence[Trial]) -> Proportion:
    """Parameters of the term that is not there, each joint's by itself, kept as significant."""
    absent = [row for t in trials if t.absent for row in t.rows if row.key.startswith(f"{t.absent}.")]
    return Proportion(sum(row.significant for row in absent), len(absent))


def _present_kept(trials: Sequence[Trial], case: Case) -> Proportion:
    """Parameters of terms that are there and five bounds or more from zero, kept as significant."""
    strong = [
        row
        for trial in trials
        for row in trial.rows
        if "." in row.key
        and row.key in case.truth
        and row.key not in case.unknown
        and abs(row.truth) >= 5.0 * row.bound
    ]
    return Proportion(sum(row.significant for row in strong), len(strong))


def show(summary: Summary) -> RenderableType:
    """A table and a few lines."""
    noise = "coloured" if summary.coloured else "white"
    table = Table(
        title=f"{summary.case}: {summary.trials} recordings, {noise} noise",
        title_justify="left", title_style="bold", box=None, pad_edge=False,
    )  # fmt: skip
    for name in ("parameter", "error / Cramér-Rao", "bias, bounds", "99 % interval covers"):
        table.add_column(name, justify="left" if name == "parameter" else "right")
    for p in summary.parameters:
        bias = f"{p.bias:+.2f} ± {p.bias_error:.2f}"
        table.add_row(p.key, f"{p.ratio:.2f}", bias, str(p.coverage))
    lines = [
        f"pooled coverage {summary.pooled}",
        f"absent terms kept {summary.absent_kept}; present ones (5 σ) kept {summary.present_kept}",
        f"R² on test below that of the truth by {100 * summary.r2_gap:.3f} points (median); "
        f"{summary.seconds:.1f} s a fit (median)",
    ]
    if summary.declared.total:
        lines.append(
            f"what cannot be known is declared {summary.declared}; declared or covered {summary.never_narrow}"
        )
    return Group(table, *(Text("  " + line) for line in lines), Text(""))
