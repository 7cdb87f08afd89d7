"""A fit or a diagnosis as text on the screen: the answer first, then its evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.text import Text

from labhil.analysis.schema import (
    ChannelErrors,
    DiagnosisPart,
    FitPart,
    Improvement,
    MissingEffect,
    Parameter,
    Rival,
    Score,
)
from labhil.analysis.verdicts import FIT_VERDICTS, NOT_TESTED, VERDICTS, disagreement
from labhil.physics.terms import keyed, listed
from labhil.report.exclusions import group_undecided, joints_table, limits_by_joint
from labhil.report.formatting import (
    format_interval,
    format_multiple,
    format_p_value,
    format_percent,
    format_probability,
    format_quantity,
    is_refuted,
)
from labhil.report.parameter_columns import COLUMNS
from labhil.tui.fitting_table import FittingTable, has_room
from labhil.tui.formatting import PlainTable

Colours = dict[str, str]

ENDED_EARLY = "▲ It was ended early: this is the best so far."

VERDICT_LABELS = {
    "no_mismatch": ("✓", "success"),
    "parameter_change": ("≠", "warning"),
    "missing_physics": ("◆", "accent"),
    "unexplained_mismatch": ("?", "warning"),
    "data_fault": ("▲", "error"),
    "not_decidable": ("○", "muted"),
}


def result_renderable(part: FitPart | DiagnosisPart, colours: Colours) -> RenderableType:
    """Return a result as text."""
    return diagnosis_text(part, colours) if isinstance(part, DiagnosisPart) else fit_text(part, colours)


def headline(part: FitPart | DiagnosisPart) -> str:
    """Return a result in a few words, for a list."""
    if isinstance(part, FitPart):
        score = part.test or part.train
        data = "on test data" if part.test is not None else "on what it was fitted to"
        summary = f"R² {format_percent(score.r2)} {data}, {len(part.parameters)} parameters"
        return summary if part.verdict in (None, "explained") else f"{FIT_VERDICTS[part.verdict]}; {summary}"
    missing = ", ".join(keyed(item.term, item.joint) for item in part.missing)
    return missing or VERDICTS[part.verdict].rstrip(".")


def fit_text(fit: FitPart, colours: Colours) -> RenderableType:
    """Return a fit: its quality, the parameters, what is not identifiable, and what to do next."""
    score = fit.test or fit.train
    data = "data it has not seen" if fit.test is not None else "the data it was fitted to"
    head = Text()
    if fit.statement is not None:
        colour = colours["success" if fit.verdict == "explained" else "warning"]
        head.append(f"{fit.statement}\n", style=f"bold {colour}")
    if not fit.complete:
        head.append(f"{ENDED_EARLY}\n", style=colours["warning"])
    for doubt in fit.doubts:
        head.append(f"▲ {doubt}\n", style=colours["warning"])
    head.append(f"R² {format_percent(score.r2)}", style=f"bold {colours['success']}")
    head.append(f" on {data}\n")
    head.append(f"RMSE {format_quantity(score.rmse, score.unit)}, ")
    head.append(f"noise floor {format_quantity(score.noise_floor, score.unit)}")
    head.append(f" ({format_multiple(score.rmse, score.noise_floor)})", style=colours["muted"])
    parts: list[RenderableType] = [
        head,
        section_title("Parameters", colours),
        ParameterTableView(fit.judged_rows, colours),
    ]
    if fit.identifiability.rank < fit.identifiability.of:
        parts.append(_identifiability(fit, colours))
    parts += [
        section_title("Errors", colours),
        _scores(fit),
        section_title("How", colours),
        _method(fit, colours),
        *next_steps_lines(fit.next_steps, colours),
    ]
    return Group(*parts)


def section_title(text: str, colours: Colours) -> Text:
    """Return a heading after a blank line."""
    return Text(f"\n{text}", style=f"bold {colours['primary']}")


@dataclass(frozen=True, slots=True)
class ParameterTableView:
    """Show one row per parameter, with a remark on those that are not reliable.

    In a narrow area, first remarks, then names, then figures take lines of their own instead of being cut.
    """

    rows: Sequence[Parameter]
    colours: Colours

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the table in as few lines as the width allows."""
        for name, cells in (
            ("", self._remark_beside),
            ("", self._remark_below),
            (".\n  ", self._remark_below),
        ):
            table = self._table(name, cells)
            if has_room(table, console, options):
                yield table
                return
        yield FittingTable(self._table("", self._remark_below))

    def _table(self, dot: str, layout: Callable[[Parameter, str], Sequence[Text]]) -> PlainTable:
        """The table with ``dot`` in the place of the first dot in each name, unless it is empty."""
        columns = [column.screen for column in COLUMNS if column.screen is not None]
        style = self.colours["muted"]
        table = PlainTable(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style=style)
        table.add_column("parameter", no_wrap=True)
        for i, (name, _) in enumerate(columns):
            table.add_column(name, justify="left" if i else "right", no_wrap=True)
        for row in self.rows:
            first, *last = layout(row, row.key.replace(".", dot, 1) if dot else row.key)
            cells = [Text(cell(row), style="" if i else "bold") for i, (_, cell) in enumerate(columns)]
            table.add_row(first, *cells, *last)
        return table

    def _remark_beside(self, row: Parameter, name: str) -> Sequence[Text]:
        """A name, and a remark behind all figures."""
        return Text(name), _remark(row, self.colours)

    def _remark_below(self, row: Parameter, name: str) -> Sequence[Text]:
        """A name with a remark below."""
        remark = _remark(row, self.colours)
        return (Text.assemble(name, "\n  ", remark) if remark.plain else Text(name),)


def _remark(row: Parameter, colours: Colours) -> Text:
    if row.held:
        return Text("○ held", style=colours["muted"])
    if not row.identifiable:
        return Text("▲ not identifiable", style=colours["warning"])
    if row.at_bound:
        return Text("▲ at its bound", style=colours["warning"])
    if row.significant is False:
        return Text("○ may be zero", style=colours["muted"])
    return Text("")


def _identifiability(fit: FitPart, colours: Colours) -> Text:
    identifiability = fit.identifiability
    text = Text(
        f"\n▲ The data know {identifiability.rank} of {identifiability.of} parameters",
        style=colours["warning"],
    )
    if identifiability.combinations:
        text.append(f"; of the rest only {', '.join(identifiability.combinations)}")
    if identifiability.would_help:
        text.append(f". It would help to record or to know {', '.join(identifiability.would_help)}")
    return text.append(".")


def _scores(fit: FitPart) -> FittingTable:
    table = _plain_table(("data", "channel"), ("RMSE", "noise floor", "R²"))
    for name, score in (("fitted", fit.train), ("test", fit.test)):
        for row in _rows_of(score):
            table.add_row(
                name,
                keyed(row.channel, row.joint),
                format_quantity(row.rmse, row.unit),
                format_quantity(row.noise_floor, row.unit),
                format_percent(row.r2),
            )
    return FittingTable(table)


def _rows_of(score: Score | None) -> Sequence[ChannelErrors]:
    return () if score is None else score.per_channel


def _plain_table(text_columns: Sequence[str], number_columns: Sequence[str]) -> PlainTable:
    table = PlainTable(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for name in text_columns:
        table.add_column(name, no_wrap=True)
    for name in number_columns:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _method(fit: FitPart, colours: Colours) -> Text:
    text = Text(style=colours["muted"])
    text.append(f"terms: {', '.join(listed(fit.terms))}\n")
    text.append(f"estimator {fit.estimator}, seed {fit.seed}, {fit.evaluations} simulations")
    text.append(f", {format_quantity(fit.seconds, 's', 3)}\n")
    white, free = fit.residuals.ljung_box_p, fit.residuals.input_crosscorrelation_p
    text.append(f"residuals {_tested('white', white)}, {_tested('free of the input', free)}\n")
    text.append(_sources(fit))
    return text


def _tested(assumed: str, p: float | None) -> str:
    """What a test of the residuals says of what is assumed of them."""
    return f"{'not ' if is_refuted(p) else ''}{assumed} with p {format_p_value(p)}"


def _sources(part: FitPart | DiagnosisPart) -> str:
    return "\n".join(
        f"{source.role or 'used'}: {Path(source.path).name}, {source.samples} samples"
        for source in part.recordings
    )


def diagnosis_text(diagnosis: DiagnosisPart, colours: Colours) -> RenderableType:
    """Return a diagnosis: verdict, missing terms, improvement, rivals, exclusions."""
    sign, colour = VERDICT_LABELS[diagnosis.verdict]
    head = Text()
    head.append(f"{sign} {VERDICTS[diagnosis.verdict]}\n", style=f"bold {colours[colour]}")
    head.append(f"baseline {', '.join(listed(diagnosis.baseline.terms))}; ", style=colours["muted"])
    suffices = (
        f"p {format_p_value(diagnosis.p_value)} that it suffices" if diagnosis.asks_baseline else NOT_TESTED
    )
    head.append(f"{suffices}\n", style=colours["muted"])
    if not diagnosis.complete:
        head.append(f"{ENDED_EARLY}\n", style=colours["warning"])
    for size in diagnosis.collapsed:
        head.append(f"▲ {size.statement}\n", style=colours["warning"])
    for fault in diagnosis.faults:
        head.append(f"▲ {fault.statement}\n", style=colours["warning"])
    if diagnosis.location is not None:
        head.append(f"{diagnosis.location.statement}\n")
    head.rstrip()
    parts: list[RenderableType] = [head]
    if diagnosis.missing:
        parts.append(section_title("What is missing", colours))
    for number, item in enumerate(diagnosis.missing):
        parts += [Text()] if number else []
        parts.append(_missing_effect(item, diagnosis.rivals, colours))
    if diagnosis.changed:
        parts += [section_title("What has changed", colours), _changes(diagnosis)]
    if diagnosis.improvement is not None:
        parts += [section_title("How much better", colours), _improvement(diagnosis.improvement, colours)]
    parts += [section_title("Final model", colours), ParameterTableView(diagnosis.judged_rows, colours)]
    parts += [Text(line) for line in [disagreement(diagnosis.scale_factor)] if line]
    return Group(
        *parts, *_exclusions_and_sources(diagnosis, colours), *next_steps_lines(diagnosis.next_steps, colours)
    )


def next_steps_lines(steps: Sequence[str], colours: Colours) -> Iterator[RenderableType]:
    """Yield what to do next, a line each, under a heading; nothing for no steps."""
    if steps:
        yield section_title("What to do next", colours)
        yield from (Text(f"· {step}") for step in steps)


def _missing_effect(item: MissingEffect, rivals: Sequence[Rival], colours: Colours) -> RenderableType:
    text = Text()
    text.append(f"◆ {keyed(item.term, item.joint)}", style=f"bold {colours['accent']}")
    text.append(f"  probability {format_probability(item.probability)}\n")
    text.append(f"{item.statement}\n")
    if item.equation:
        text.append(f"{item.equation}\n", style="italic")
    evidence = item.evidence
    text.append(
        f"ΔBIC {format_quantity(evidence.delta_bic, digits=3)}, held-out gain "
        f"{format_quantity(evidence.heldout_loglik_gain, 'nats', 3)}\n",
        style=colours["muted"],
    )
    for rival in rivals:
        if (rival.instead_of, rival.joint) == (item.term, item.joint):
            distinction = (
                "can be told apart by" if rival.distinguishable else "cannot be told apart here; try"
            )
            text.append(f"  or {keyed(rival.term, rival.joint)} ({format_probability(rival.probability)}), ")
            text.append(f"{distinction} {rival.experiment}\n", style=colours["muted"])
    text.rstrip()
    return text


def _changes(diagnosis: DiagnosisPart) -> FittingTable:
    table = _plain_table(("parameter",), ("before", "after", "99 % interval", "p"))
    for change in diagnosis.changed:
        table.add_row(
            keyed(change.name, change.joint, change.recording),
            format_quantity(change.before, change.unit),
            format_quantity(change.after, change.unit),
            format_interval(change.ci99),
            format_p_value(change.p_value),
        )
    return FittingTable(table)


def _improvement(improvement: Improvement, colours: Colours) -> RenderableType:
    data = "the test recording" if improvement.data == "test" else "held-out data"
    horizon = (
        "" if improvement.horizon is None else f", windows of {format_quantity(improvement.horizon, 's')}"
    )
    where = Text(f"on {data}{horizon}", style=colours["muted"])
    table = _plain_table(("",), ("before", "after", "noise floor"))
    table.add_row(
        "RMSE",
        format_quantity(improvement.rmse_before, improvement.unit),
        Text(format_quantity(improvement.rmse_after, improvement.unit), style="bold"),
        format_quantity(improvement.noise_floor, improvement.unit),
    )
    table.add_row(
        "R²",
        format_percent(improvement.r2_before),
        Text(format_percent(improvement.r2_after), style="bold"),
        "",
    )
    return Group(where, FittingTable(table), _bars(improvement, colours))


def _bars(improvement: Improvement, colours: Colours) -> Text:
    """Errors as bars, in multiples of the noise floor, on a logarithmic scale."""
    import math

    text = Text()
    if not improvement.noise_floor:
        return text
    floor = improvement.noise_floor
    bars = [
        ("before", improvement.rmse_before, "warning"),
        ("after", improvement.rmse_after, "success"),
        ("noise", floor, "muted"),
    ]
    for name, value, colour in bars:
        ratio = max(value or 0.0, 1e-12) / floor
        length = round(min(40.0, max(1.0, 4.0 + 12.0 * math.log10(ratio))))
        text.append(f"{name:<7}", style=colours["muted"])
        text.append("█" * length, style=colours[colour])
        text.append(f" {format_multiple(value, floor)}\n")
    text.rstrip()
    return text


def _exclusions_and_sources(diagnosis: DiagnosisPart, colours: Colours) -> Iterator[RenderableType]:
    """Excluded and undecided terms, and the recordings of the result."""
    muted = colours["muted"]
    without_joint = [e for e in diagnosis.excluded if e.joint is None]
    limits = [
        f"{keyed(e.term, None, e.recording)} {format_quantity(e.largest_hidden, e.unit, 2)}"
        for e in without_joint
    ]
    if limits:
        yield Text(f"\nNot there, or smaller than: {', '.join(limits)}.", style=muted)
    by_joint = limits_by_joint(diagnosis.excluded)
    if by_joint:
        yield Text("\nNot there, or smaller than this, by joint", style=muted)
        yield FittingTable(joints_table(by_joint, muted))
    text = Text("\n", style=muted)
    for term in group_undecided(diagnosis.undecided):
        text.append(f"Undecided: {term.name}: {term.reason}.\n")
    yield text.append(_sources(diagnosis))
