"""A comparison of models as tables in a terminal.

The screen has its own form in ``labhil/tui/comparison_text.py``, the page in ``html/comparison.py``.
"""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.analysis.schema import ComparedModel, ComparisonPart, SharedParameter, Source, ValueOfModel
from labhil.physics.terms import keyed, listed
from labhil.report.formatting import format_number, format_p
from labhil.report.tables import titled_table
from labhil.report.text import next_steps_lines

AGREE = {True: "agree", False: "DISAGREE", None: "not known"}


def comparison_text(comparison: ComparisonPart) -> RenderableType:
    """Return the verdict, a table of models, their shared parameters, and what to do next."""
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


def comparison_basis(comparison: ComparisonPart) -> str:
    """Return a line with the recordings that the models are compared on, and the metric."""
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
    """Make a table with a row per model and output: the error in its unit and in noise levels."""
    table = titled_table(
        comparison_basis(comparison),
        ("model", "output"),
        ("RMSE", "noise levels", "R²", "parameters", "× best", "p"),
    )
    table.add_column("terms")
    for model in comparison.models:
        best = model.name == comparison.best
        for i, row in enumerate(model.per_channel):
            first = i == 0
            table.add_row(
                ("→ " if best else "  ") + model.name if first else "",
                keyed(row.channel, row.joint),
                f"{format_number(row.rmse, '.4g')} {row.unit}",
                format_number(row.rmse_over_noise, ".3g"),
                format_number(row.r2, ".5f"),
                str(model.n_parameters) if first else "",
                format_number(model.times_best, ".3g") if first else "",
                _p_cell(model, best=best) if first else "",
                Text(", ".join(listed(model.terms)) if first else ""),
                style="bold" if best else "",
            )
    return table


def _p_cell(model: ComparedModel, *, best: bool) -> str:
    return "best" if best else format_p(model.p_value)


def parameter_table(comparison: ComparisonPart) -> Table:
    """Make a table of shared parameters: the value and interval in each model, and whether they agree."""
    table = titled_table("Parameters that models share: value and 99 % interval", ("parameter",))
    for model in comparison.models:
        table.add_column(Text(model.name), justify="right")
    table.add_column("")
    table.add_column("z", justify="right")
    table.add_column("unit")
    for row in comparison.parameters:
        table.add_row(
            keyed(row.name, row.joint),
            *(format_estimate(row, model.name) for model in comparison.models),
            Text(AGREE[row.agree], style="bold red" if row.agree is False else ""),
            format_number(row.z, ".1f"),
            row.unit,
        )
    return table


def format_estimate(row: SharedParameter, model: str) -> str:
    """Format the value of a parameter in one model, with its interval.

    Args:
        row: The parameter.
        model: Name of the model.

    Returns:
        For example ``0.05 [0.04, 0.06]``; a dash where the model does not have it.
    """
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
    return f" [{format_number(low, '.4g')}, {format_number(high, '.4g')}]"
