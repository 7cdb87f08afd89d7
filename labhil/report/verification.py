"""A verification as tables in a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.analysis.schema import VerificationPart
from labhil.physics.terms import keyed
from labhil.report.formatting import format_number, format_p, format_p_relation
from labhil.report.tables import titled_table
from labhil.report.text import next_steps_lines


def verification_text(verification: VerificationPart) -> RenderableType:
    """Return verdict, tests of each output, refitted values, worst windows and next steps."""
    return Group(*_pieces(verification))


def _pieces(verification: VerificationPart) -> Iterator[RenderableType]:
    relation = "is consistent with" if verification.consistent else "contradicts"
    yield Text(
        f"The recording {relation} the model "
        f"(p {format_p_relation(verification.p_value)}, false alarms {verification.alpha:g}).",
        style="bold green" if verification.consistent else "bold red",
    )
    yield Text(verification.statement, style="" if verification.adequacy == "explained" else "yellow")
    for line in (*(f"! {fault.statement}" for fault in verification.faults), *verification.doubts):
        yield Text(line, style="yellow")
    for reason in verification.reasons:
        yield Text("· " + reason)
    for note in verification.notes:
        yield Text("· " + note, style="yellow")
    yield channel_table(verification)
    if verification.parameters:
        yield value_table(verification)
    if verification.score.horizon is not None:
        yield window_table(verification)
    yield from next_steps_lines(verification.next_steps)


def channel_table(verification: VerificationPart) -> Table:
    """Make a table with a row per output: error, noise floor, their ratio and its limit."""
    horizon = verification.score.horizon
    how = "inverse dynamics" if horizon is None else f"simulated windows of {horizon:.3g} s"
    table = titled_table(
        f"With the values as they are, {how}",
        ("output",),
        ("RMSE", "noise floor", "ratio", "limit", "p", "p of residuals and input"),
    )
    for row in verification.channels:
        table.add_row(
            keyed(row.channel, row.joint),
            f"{format_number(row.rmse, '.4g')} {row.unit}",
            f"{format_number(row.noise_floor, '.4g')} {row.unit}",
            format_number(row.ratio, ".3g"),
            format_number(row.limit, ".3g"),
            format_p(row.rmse_p),
            format_p(row.structure_p),
        )
    return table


def value_table(verification: VerificationPart) -> Table:
    """Make a table with a row per parameter: accepted value, refitted value, and whether they differ."""
    table = titled_table(
        f"Values, refitted on windows of {format_number(verification.window, '.3g')} s: "
        f"all together p {format_p_relation(verification.values_p)}",
        ("parameter",),
        ("accepted", "refitted", "± of the difference", "z", "p (all looked at)"),
    )
    table.add_column("")
    table.add_column("unit")
    for change in verification.parameters:
        table.add_row(
            keyed(change.name, change.joint),
            format_number(change.before, ".5g"),
            format_number(change.after, ".5g"),
            format_number(change.std_error, ".2g"),
            format_number(change.z, ".1f"),
            format_p(change.p_value),
            "changed" if change.changed else "",
            change.unit,
        )
    return table


def window_table(verification: VerificationPart) -> Table:
    """Make a table of the windows with the largest errors."""
    table = titled_table("Worst windows", (), ("from", "to", "RMSE / noise floor"))
    for window in verification.worst_windows:
        table.add_row(f"{window.begin:.4g} s", f"{window.end:.4g} s", format_number(window.ratio, ".3g"))
    return table
