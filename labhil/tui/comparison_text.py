"""A comparison or a verification as text: the answer first, then what it rests on."""

from __future__ import annotations

from collections.abc import Iterator
from string import ascii_uppercase

from rich.console import Group, RenderableType
from rich.text import Text

from labhil.analysis.schema import ComparedModel, ComparisonPart, VerificationPart
from labhil.physics.terms import keyed, listed
from labhil.report.comparison import AGREE, on_what, value_text
from labhil.report.html.quantity import p_value, percent, quantity
from labhil.tui.result_text import next_steps_lines
from labhil.tui.words import PlainTable

Colours = dict[str, str]


def comparison_headline(found: ComparisonPart) -> str:
    """A comparison in a few words, for a list."""
    equals = [model.name for model in found.models if not model.worse_than_best]
    if found.verdict == "alike":
        return f"{', '.join(equals)} alike"
    others = [model for model in found.models if model.name != found.best]
    nearest = min((model.times_best for model in others if model.times_best is not None), default=None)
    return f"{found.best} best" + ("" if nearest is None else f", the next × {nearest:.3g}")


def comparison_renderable(found: ComparisonPart, colours: Colours) -> RenderableType:
    """The statement, a table of models, one of the parameters that they share, and what to do next."""
    return Group(*_comparison(found, colours))


def _comparison(found: ComparisonPart, colours: Colours) -> Iterator[RenderableType]:
    explained = found.best_model.adequacy == "explained"
    yield Text(found.statement, style=f"bold {colours['success' if explained else 'warning']}")
    for note in found.notes:
        yield Text(f"▲ {note}", style=colours["warning"])
    yield Text("\nModels", style=f"bold {colours['primary']}")
    yield Text(on_what(found), style=colours["muted"])
    yield _models(found, colours)
    for letter, model in _lettered(found):
        line = Text(f"{letter}  {model.name}: ", style="bold" if model.name == found.best else "")
        yield line.append(", ".join(listed(model.terms)), style=f"not bold {colours['muted']}")
    if found.parameters:
        yield Text("\nParameters that they share", style=f"bold {colours['primary']}")
        yield _parameters(found, colours)
    yield from next_steps_lines(found.next_steps, colours)


def _models(found: ComparisonPart, colours: Colours) -> PlainTable:
    table = _table(colours, ("output", ""), ("RMSE", "in noise", "× best", "p", "R²"))
    for letter, model in _lettered(found):
        best = model.name == found.best
        for place, row in enumerate(model.per_channel):
            table.add_row(
                keyed(row.channel, row.joint),
                f"{letter}{' ←' if best else ''}" if place == 0 else "",
                quantity(row.rmse, row.unit),
                quantity(row.rmse_over_noise, "", 3),
                "best" if best else quantity(model.times_best, "", 3) if place == 0 else "",
                "" if best or place else p_value(model.p_value),
                percent(row.r2),
                style="bold" if best else "",
            )
    return table


def _lettered(found: ComparisonPart) -> Iterator[tuple[str, ComparedModel]]:
    """The models with a letter each: names of files leave no room for numbers."""
    yield from zip(ascii_uppercase, found.models, strict=False)


def _parameters(found: ComparisonPart, colours: Colours) -> PlainTable:
    names = [model.name for model in found.models]
    table = _table(colours, ("parameter",), (*(letter for letter, _ in _lettered(found)), ""))
    for row in found.parameters:
        unit = f" {row.unit}" if row.unit else ""
        table.add_row(
            f"{keyed(row.name, row.joint)}{unit}",
            *(value_text(row, name) for name in names),
            Text(AGREE[row.agree], style=colours["warning"] if row.agree is False else ""),
        )
    return table


def verification_headline(found: VerificationPart) -> str:
    """A verification in a few words, for a list."""
    return found.verdict


def verification_renderable(found: VerificationPart, colours: Colours) -> RenderableType:
    """The answer, the reasons, each output's error, and the values that have changed."""
    return Group(*_verification(found, colours))


def _verification(found: VerificationPart, colours: Colours) -> Iterator[RenderableType]:
    sign, word = ("✓", "consistent with") if found.consistent else ("✕", "contradicted by")
    colour = colours["success" if found.consistent else "error"]
    yield Text(
        f"{sign} The model is {word} the recording (p {p_value(found.p_value)}).", style=f"bold {colour}"
    )
    yield Text(found.statement, style="" if found.adequacy == "explained" else colours["warning"])
    for line in (*(fault.statement for fault in found.faults), *found.doubts, *found.notes):
        yield Text(f"▲ {line}", style=colours["warning"])
    yield from (Text(f"· {reason}") for reason in found.reasons)
    yield Text("\nErrors", style=f"bold {colours['primary']}")
    errors = _table(colours, ("output",), ("RMSE", "noise floor", "ratio", "limit"))
    for row in found.channels:
        errors.add_row(
            keyed(row.channel, row.joint),
            quantity(row.rmse, row.unit),
            quantity(row.noise_floor, row.unit),
            quantity(row.ratio, "", 3),
            quantity(row.limit, "", 3),
        )
    yield errors
    if found.parameters:
        yield Text("\nValues", style=f"bold {colours['primary']}")
        values = _table(colours, ("parameter",), ("accepted", "refitted", ""))
        for value in found.parameters:
            changed = Text("≠ changed" if value.changed else "", style=colours["warning"])
            values.add_row(
                keyed(value.name, value.joint),
                quantity(value.before, value.unit),
                quantity(value.after, value.unit),
                changed,
            )
        yield values
    yield Text(f"\nmodel: {found.model}", style=colours["muted"])


def _table(colours: Colours, words: tuple[str, ...], numbers: tuple[str, ...]) -> PlainTable:
    table = PlainTable(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style=colours["muted"])
    for place, name in enumerate(words):
        # where room is short the first column is cut: one that may be wrapped is made narrow first
        table.add_column(Text(name), overflow="ellipsis", no_wrap=place > 0)
    for name in numbers:
        table.add_column(Text(name), justify="right", no_wrap=True)
    return table
