"""A comparison of models as tables for a person."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.analysis.schema import ComparedModel, ComparisonPart, SharedParameter, Source, ValueOfModel
from labhil.physics.terms import keyed, listed
from labhil.report.parameter_columns import figure, small
from labhil.report.text import next_steps_lines

AGREE = {True: "agree", False: "DISAGREE", None: "not known"}


def comparison_text(found: ComparisonPart) -> RenderableType:
    """The answer, a table of models, one of the parameters that they share, and what to do next."""
    return Group(*_pieces(found))


def _pieces(found: ComparisonPart) -> Iterator[RenderableType]:
    explained = found.best_model.adequacy == "explained"
    yield Text(found.statement, style="bold green" if explained else "bold yellow")
    for note in found.notes:
        yield Text(f"! {note}", style="yellow")
    yield model_table(found)
    if found.parameters:
        yield parameter_table(found)
    yield from next_steps_lines(found.next_steps)


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)


def on_what(found: ComparisonPart) -> str:
    """Which recordings the models are compared on, and how."""
    how = "inverse dynamics" if found.horizon is None else f"simulated windows of {found.horizon:.3g} s"
    return f"On {', '.join(map(_stretch, found.recordings))}; {how}"


def _stretch(source: Source) -> str:
    begin = source.start or 0.0
    return f"{source.path} from {begin:.4g} to {begin + (source.duration or 0.0):.4g} s"


def model_table(found: ComparisonPart) -> Table:
    """A row per model and output: its error in its unit and in noise levels."""
    table = _table(on_what(found))
    for name in ("model", "output"):
        table.add_column(name, no_wrap=True)
    for name in ("RMSE", "noise levels", "R²", "parameters", "× best", "p"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("terms")
    for model in found.models:
        best = model.name == found.best
        for place, row in enumerate(model.per_channel):
            first = place == 0
            table.add_row(
                ("→ " if best else "  ") + model.name if first else "",
                keyed(row.channel, row.joint),
                f"{figure(row.rmse, '.4g')} {row.unit}",
                figure(row.rmse_over_noise, ".3g"),
                figure(row.r2, ".5f"),
                str(model.n_parameters) if first else "",
                figure(model.times_best, ".3g") if first else "",
                _p(model, best=best) if first else "",
                Text(", ".join(listed(model.terms)) if first else ""),
                style="bold" if best else "",
            )
    return table


def _p(model: ComparedModel, *, best: bool) -> str:
    return "best" if best else small(model.p_value).removeprefix("= ")


def parameter_table(found: ComparisonPart) -> Table:
    """A row per shared parameter: its value and interval in each model, and whether they agree."""
    table = _table("Parameters that models share: value and 99 % interval")
    table.add_column("parameter", no_wrap=True)
    for model in found.models:
        table.add_column(Text(model.name), justify="right")
    table.add_column("")
    table.add_column("z", justify="right")
    table.add_column("unit")
    for row in found.parameters:
        table.add_row(
            keyed(row.name, row.joint),
            *(value_text(row, model.name) for model in found.models),
            Text(AGREE[row.agree], style="bold red" if row.agree is False else ""),
            figure(row.z, ".1f"),
            row.unit,
        )
    return table


def value_text(row: SharedParameter, model: str) -> str:
    """The value of a model, with its interval; a dash where it has none."""
    value = next((each for each in row.values if each.model == model), None)
    if value is None or value.value is None:
        return "–"
    return f"{value.value:.4g}{_interval(value)}"


def _interval(value: ValueOfModel) -> str:
    if value.held:
        return " held"
    if not value.identifiable or value.ci99 is None:
        return " not known"
    low, high = value.ci99
    return f" [{figure(low, '.4g')}, {figure(high, '.4g')}]"
