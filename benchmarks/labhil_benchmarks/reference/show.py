"""The tables on a terminal."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from labhil_benchmarks.reference.result import NAMES, Reference, Table
from labhil_benchmarks.reference.wording import bound_of, figure_of, interval, label, number


def show_reference(reference: Reference) -> RenderableType:
    """All tables and findings."""
    parts: list[RenderableType] = [Text(head(reference)), Text("")]
    for table in reference.tables:
        parts += [show_table(table), Text("")]
    parts.append(Text("Where the text's claims do not stand", style="bold"))
    parts += [Text(f"• {text}") for text in reference.findings]
    return Group(*parts)


def head(reference: Reference) -> str:
    """What was run, in one line."""
    quick = "A quick run, no result to quote: " if reference.quick else ""
    return f"{quick}{reference.budget}; seed {reference.seed}; {reference.seconds:.0f} s."


def show_table(table: Table) -> RenderableType:
    """One table with its notes."""
    shown = _parameters(table) if table.rows else _scores(table)
    shown.title, shown.title_justify, shown.title_style = table.heading, "left", "bold"
    return Group(shown, *(Text(f"  {note}") for note in table.notes))


def _parameters(table: Table) -> RichTable:
    shown = RichTable(box=None, pad_edge=False)
    shown.add_column("parameter")
    for name in ("truth", "bound, σ", *NAMES.values(), "99 % interval", "text's formula"):
        shown.add_column(name, justify="right")
    for row in table.rows:
        cells = ["\n".join(figure_of(row.figures.get(way))) for way in NAMES]
        ends = [Text(interval(e, row.truth)) for e in (row.interval, row.text_formula)]
        shown.add_row(Text(f"{label(row)} [{row.unit}]"), number(row.truth), bound_of(row), *cells, *ends)
    return shown


def _scores(table: Table) -> RichTable:
    shown = RichTable(box=None, pad_edge=False)
    shown.add_column("model")
    names = ("output", "RMSE", "MSE", "largest error", "R², %", "text's MSE", "text's R², %")
    for name in names:
        shown.add_column(name, justify="right")
    for row in table.scores:
        output = row.channel if row.joint is None else f"joint {row.joint}"
        shown.add_row(
            row.model,
            output,
            f"{number(row.rmse)} {row.unit}",
            f"{number(row.mse)} ({row.unit})²",
            f"{number(row.max_abs_error, 3)} {row.unit}",
            number(row.r2, 5),
            number(row.printed_mse),
            number(row.printed_r2),
        )
    return shown
