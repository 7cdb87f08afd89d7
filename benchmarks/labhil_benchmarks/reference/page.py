"""The tables as a page of Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from labhil_benchmarks.reference.result import NAMES, Reference, Table
from labhil_benchmarks.reference.show import head
from labhil_benchmarks.reference.wording import bound_of, figure_of, interval, label, number

INTRODUCTION = """\
# The reference text's chapter 5

Every table of results of chapter 5 of *Modeling of Dynamic Systems and Nonlinear System Identification*,
beside ours on data of plants with its parameters. Written by `labhil reference --markdown FILE`.

- **truth**: the plant's value. For the motor and the solenoid it is the text's real value; for ball and beam
  and the UR5, which the text measured on hardware, its PSO value, so that its numbers mean what it meant.
- **bound, σ**: the Cramér-Rao bound, the smallest standard error of any unbiased estimator on these data, in
  the row's unit and in % of the truth; "none" where the data do not know the value at all. It is a lower
  limit that curvature at the truth gives: where it is a large share of the value (a static level, a Stribeck
  velocity) the likelihood is no parabola and honest errors can be several times as large.
- **text: PSO**, **text: NLSE**: as printed. Every cell has the value, its error in % and in bounds.
- **ours: text's swarm**: equations 3.1 to 3.4, its particles and iterations, in a box from zero to five times
  the truth (a Stribeck level also as far below zero). The text says nothing of its box; this one knows the
  truth's order of magnitude, which the default does not.
- **ours: one least squares from a rough start**: one Levenberg-Marquardt, every value of the text off by a
  factor of its own between 1/3 and 3, drawn with a fixed seed.
- **ours: default**: `labhil fit` as it is, told nothing of truth, box or initial state.

The text's levels and ours: its static level F_s is the sum of our Coulomb and Stribeck levels, and the error
of the sum is taken with their covariance.
"""


def page(reference: Reference) -> str:
    """The whole page."""
    parts = [INTRODUCTION, head(reference), "", "## Where the text's claims do not stand", ""]
    parts += [f"- {text}" for text in reference.findings]
    for table in reference.tables:
        parts += ["", *_table(table)]
    return "\n".join(parts) + "\n"


def _table(table: Table) -> list[str]:
    lines = [f"## {table.heading}", "", table.setup, ""]
    lines += _parameters(table) if table.rows else _scores(table)
    lines += [""] + [f"- {note}" for note in table.notes]
    if any(row.interval is not None for row in table.rows):
        lines += ["", *_intervals(table)]
    return lines


def _parameters(table: Table) -> list[str]:
    rows = []
    for row in table.rows:
        cells = [" ".join(_cell(*figure_of(row.figures.get(way)))) for way in NAMES]
        rows.append([f"{label(row)}, {row.unit}", number(row.truth), bound_of(row), *cells])
    return _grid(["parameter", "truth", "bound, σ", *NAMES.values()], rows)


def _cell(value: str, errors: str) -> tuple[str, ...]:
    return (value, f"({errors})") if errors else (value,)


def _intervals(table: Table) -> list[str]:
    rows = [
        [
            label(row),
            number(row.truth),
            interval(row.interval, row.truth),
            interval(row.text_formula, row.truth),
            interval(row.text_interval, row.truth),
        ]
        for row in table.rows
    ]
    title = "99 % intervals around the default's estimate; ✗ where the truth is not inside:"
    return [
        title,
        "",
        *_grid(["parameter", "truth", "ours", "text's formula on ours", "text's, printed"], rows),
    ]


def _scores(table: Table) -> list[str]:
    rows = [
        [
            row.model,
            row.channel if row.joint is None else f"{row.channel}, joint {row.joint}",
            f"{number(row.rmse)} {row.unit}",
            f"{number(row.mse)} ({row.unit})²",
            f"{number(row.max_abs_error, 3)} {row.unit}",
            number(row.r2, 5),
            number(row.printed_mse),
            number(row.printed_r2),
        ]
        for row in table.scores
    ]
    names = ["model", "output", "RMSE", "MSE", "largest error", "R², %", 'text\'s "MSE"', "text's R², %"]
    return _grid(names, rows)


def _grid(names: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(names) + " |", "|" + "|".join([" --- "] + [" ---: "] * (len(names) - 1)) + "|"]
    return lines + ["| " + " | ".join(cells) + " |" for cells in rows]
