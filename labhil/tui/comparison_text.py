"""A comparison or a verification as text on the screen."""

from __future__ import annotations

from collections.abc import Iterator
from string import ascii_uppercase

from rich.console import Group, RenderableType
from rich.text import Text

from labhil.analysis.schema import ComparedModel, ComparisonPart, VerificationPart
from labhil.physics.terms import keyed, listed
from labhil.report.comparison import AGREE, comparison_basis, format_estimate
from labhil.report.formatting import format_p_value, format_percent, format_quantity
from labhil.tui.fitting_table import FittingTable
from labhil.tui.formatting import PlainTable
from labhil.tui.result_text import Colours, next_steps_lines, section_title


def comparison_headline(comparison: ComparisonPart) -> str:
    """Return a comparison in a few words, for a list."""
    equals = [model.name for model in comparison.models if not model.worse_than_best]
    if comparison.verdict == "alike":
        return f"{', '.join(equals)} alike"
    others = [model for model in comparison.models if model.name != comparison.best]
    nearest = min((model.times_best for model in others if model.times_best is not None), default=None)
    return f"{comparison.best} best" + ("" if nearest is None else f", the next × {nearest:.3g}")


def comparison_renderable(comparison: ComparisonPart, colours: Colours) -> RenderableType:
    """Return the verdict, a table of models, their shared parameters, and what to do next."""
    return Group(*_comparison(comparison, colours))


def _comparison(comparison: ComparisonPart, colours: Colours) -> Iterator[RenderableType]:
    explained = comparison.best_model.adequacy == "explained"
    yield Text(comparison.statement, style=f"bold {colours['success' if explained else 'warning']}")
    for note in comparison.notes:
        yield Text(f"▲ {note}", style=colours["warning"])
    yield section_title("Models", colours)
    yield Text(comparison_basis(comparison), style=colours["muted"])
    yield _models(comparison, colours)
    for letter, model in _models_by_letter(comparison):
        line = Text(f"{letter}  {model.name}: ", style="bold" if model.name == comparison.best else "")
        yield line.append(", ".join(listed(model.terms)), style=f"not bold {colours['muted']}")
    if comparison.parameters:
        yield section_title("Parameters that they share", colours)
        yield _parameters(comparison, colours)
    yield from next_steps_lines(comparison.next_steps, colours)


def _models(comparison: ComparisonPart, colours: Colours) -> FittingTable:
    table = _table(colours, ("output", ""), ("RMSE", "in noise", "× best", "p", "R²"))
    for letter, model in _models_by_letter(comparison):
        best = model.name == comparison.best
        for i, row in enumerate(model.per_channel):
            table.add_row(
                keyed(row.channel, row.joint),
                f"{letter}{' ←' if best else ''}" if i == 0 else "",
                format_quantity(row.rmse, row.unit),
                format_quantity(row.rmse_over_noise, "", 3),
                ("best" if best else format_quantity(model.times_best, "", 3)) if i == 0 else "",
                "" if best or i else format_p_value(model.p_value),
                format_percent(row.r2),
                style="bold" if best else "",
            )
    return FittingTable(table)


def _models_by_letter(comparison: ComparisonPart) -> Iterator[tuple[str, ComparedModel]]:
    """The models with a letter each: file names leave no room for numbers."""
    yield from zip(ascii_uppercase, comparison.models, strict=False)


def _parameters(comparison: ComparisonPart, colours: Colours) -> FittingTable:
    names = [model.name for model in comparison.models]
    table = _table(colours, ("parameter",), (*(letter for letter, _ in _models_by_letter(comparison)), ""))
    for row in comparison.parameters:
        unit = f" {row.unit}" if row.unit else ""
        table.add_row(
            f"{keyed(row.name, row.joint)}{unit}",
            *(format_estimate(row, name) for name in names),
            Text(AGREE[row.agree], style=colours["warning"] if row.agree is False else ""),
        )
    return FittingTable(table)


def verification_headline(verification: VerificationPart) -> str:
    """Return a verification in a few words, for a list."""
    return verification.verdict


def verification_renderable(verification: VerificationPart, colours: Colours) -> RenderableType:
    """Return the verdict, the reasons, the errors of each output, changed parameters, and what to do next."""
    return Group(*_verification(verification, colours))


def _verification(verification: VerificationPart, colours: Colours) -> Iterator[RenderableType]:
    sign, word = ("✓", "consistent with") if verification.consistent else ("✕", "contradicted by")
    colour = colours["success" if verification.consistent else "error"]
    yield Text(
        f"{sign} The model is {word} the recording (p {format_p_value(verification.p_value)}).",
        style=f"bold {colour}",
    )
    yield Text(
        verification.statement, style="" if verification.adequacy == "explained" else colours["warning"]
    )
    for line in (
        *(fault.statement for fault in verification.faults),
        *verification.doubts,
        *verification.notes,
    ):
        yield Text(f"▲ {line}", style=colours["warning"])
    yield from (Text(f"· {reason}") for reason in verification.reasons)
    yield section_title("Errors", colours)
    errors = _table(colours, ("output",), ("RMSE", "noise floor", "ratio", "limit"))
    for row in verification.channels:
        errors.add_row(
            keyed(row.channel, row.joint),
            format_quantity(row.rmse, row.unit),
            format_quantity(row.noise_floor, row.unit),
            format_quantity(row.ratio, "", 3),
            format_quantity(row.limit, "", 3),
        )
    yield FittingTable(errors)
    if verification.parameters:
        yield section_title("Values", colours)
        values = _table(colours, ("parameter",), ("accepted", "refitted", ""))
        for value in verification.parameters:
            changed = Text("≠ changed" if value.changed else "", style=colours["warning"])
            values.add_row(
                keyed(value.name, value.joint),
                format_quantity(value.before, value.unit),
                format_quantity(value.after, value.unit),
                changed,
            )
        yield FittingTable(values)
    yield Text(f"\nmodel: {verification.model}", style=colours["muted"])
    yield from next_steps_lines(verification.next_steps, colours)


def _table(colours: Colours, text_columns: tuple[str, ...], number_columns: tuple[str, ...]) -> PlainTable:
    table = PlainTable(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style=colours["muted"])
    for name in text_columns:
        table.add_column(Text(name), no_wrap=True)
    for name in number_columns:
        table.add_column(Text(name), justify="right", no_wrap=True)
    return table
