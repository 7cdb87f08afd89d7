"""A comparison of models as tables for a person."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.analysis.schema import ComparedModel, ComparisonPart, SharedParameter, Source, ValueOfModel
from labhil.physics.terms import keyed, listed
from labhil.report.parameter_columns import number_text, p_text
from labhil.report.text import next_steps_lines

AGREE = {True: "agree", False: "DISAGREE", None: "not known"}


def comparison_text(comparison: ComparisonPart) -> RenderableType:
    """The answer, a table of models, one of the parameters that they share, and what to do next."""
    return Group(*_pieces(comparison))


def _pieces(comparison: ComparisonPart) -> Iterator[RenderableType]:
    explained = comparison.best_model.adequacy == "explained"
    yield Text(comparison.statement, style="bold green" if explained else "bold yellow")
    for note in comparison.notes:
        yield Text(f"! {note}", style="yellow")
    yield model_table(comparison)
    if comparison.parameters:
        yield parameter_table(comparison)
    yield from next_steps_lines(comparison.next_steps)


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)


def comparison_basis(comparison: ComparisonPart) -> str:
    """Which recordings the models are compared on, and how."""
    how = (
        "inverse dynamics"
        if comparison.horizon is None
        else f"simulated windows of {comparison.horizon:.3g} s"
    )
    return f"On {', '.join(map(_stretch, comparison.recordings))}; {how}"


def _stretch(source: Source) -> str:
    begin = source.start or 0.0
    return f"{source.path} from {begin:.4g} to {begin + (source.duration or 0.0):.4g} s"


def model_table(comparison: ComparisonPart) -> Table:
    """A row per model and output: its error in its unit and in noise levels."""
    table = _table(comparison_basis(comparison))
    for name in ("model", "output"):
        table.add_column(name, no_wrap=True)
    for name in ("RMSE", "noise levels", "R²", "parameters", "× best", "p"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("terms")
    for model in comparison.models:
        best = model.name == comparison.best
        for i, row in enumerate(model.per_channel):
            first = i == 0
            table.add_row(
                ("→ " if best else "  ") + model.name if first else "",
                keyed(row.channel, row.joint),
                f"{number_text(row.rmse, '.4g')} {row.unit}",
                number_text(row.rmse_over_noise, ".3g"),
                number_text(row.r2, ".5f"),
                str(model.n_parameters) if first else "",
                number_text(model.times_best, ".3g") if first else "",
                _p_cell(model, best=best) if first else "",
                Text(", ".join(listed(model.terms)) if first else ""),
                style="bold" if best else "",
            )
    return table


def _p_cell(model: ComparedModel, *, best: bool) -> str:
    return "best" if best else p_text(model.p_value).removeprefix("= ")


def parameter_table(comparison: ComparisonPart) -> Table:
    """A row per shared parameter: its value and interval in each model, and whether they agree."""
    table = _table("Parameters that models share: value and 99 % interval")
    table.add_column("parameter", no_wrap=True)
    for model in comparison.models:
        table.add_column(Text(model.name), justify="right")
    table.add_column("")
    table.add_column("z", justify="right")
    table.add_column("unit")
    for row in comparison.parameters:
        table.add_row(
            keyed(row.name, row.joint),
            *(value_text(row, model.name) for model in comparison.models),
            Text(AGREE[row.agree], style="bold red" if row.agree is False else ""),
            number_text(row.z, ".1f"),
            row.unit,
        )
    return table


def value_text(row: SharedParameter, model: str) -> str:
    """The value of a model, with its interval; a dash where it has none."""
    estimate = next((candidate for candidate in row.values if candidate.model == model), None)
    if estimate is None or estimate.value is None:
        return "–"
    return f"{estimate.value:.4g}{_interval(estimate)}"


def _interval(value: ValueOfModel) -> str:
    if value.held:
        return " held"
    if not value.identifiable or value.ci99 is None:
        return " not known"
    low, high = value.ci99
    return f" [{number_text(low, '.4g')}, {number_text(high, '.4g')}]"
