"""A verification as tables for a person."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.analysis.schema import VerificationPart
from labhil.physics.terms import keyed
from labhil.report.parameter_columns import number_text, p_text


def show_verification(verification: VerificationPart, console: Console) -> None:
    """Print the answer, what was tested, and where the simulation is worst."""
    console.print(verification_text(verification))


def verification_text(verification: VerificationPart) -> RenderableType:
    """The answer, what was tested, and where the simulation is worst."""
    return Group(*_pieces(verification))


def _pieces(verification: VerificationPart) -> Iterator[RenderableType]:
    verdict = (
        "consistent with the model" if verification.consistent else "The recording contradicts the model"
    )
    begin = "The recording is " if verification.consistent else ""
    yield Text(
        f"{begin}{verdict} (p {p_text(verification.p_value)}, false alarms {verification.alpha:g}).",
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


def _table(title: str, words: tuple[str, ...], numbers: tuple[str, ...]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for name in words:
        table.add_column(name, no_wrap=True)
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def channel_table(verification: VerificationPart) -> Table:
    """A row per output: error over floor with its limit, and what the refitted model leaves."""
    horizon = verification.score.horizon
    how = "inverse dynamics" if horizon is None else f"simulated windows of {horizon:.3g} s"
    table = _table(
        f"With the values as they are, {how}",
        ("output",),
        ("RMSE", "noise floor", "ratio", "limit", "p", "p of residuals and input"),
    )
    for row in verification.channels:
        table.add_row(
            keyed(row.channel, row.joint),
            f"{number_text(row.rmse, '.4g')} {row.unit}",
            f"{number_text(row.noise_floor, '.4g')} {row.unit}",
            number_text(row.ratio, ".3g"),
            number_text(row.limit, ".3g"),
            p_text(row.rmse_p).removeprefix("= "),
            p_text(row.structure_p).removeprefix("= "),
        )
    return table


def value_table(verification: VerificationPart) -> Table:
    """A row per parameter: accepted, refitted, and whether they differ."""
    table = _table(
        f"Values, refitted on windows of {number_text(verification.window, '.3g')} s: "
        f"all together p {p_text(verification.values_p)}",
        ("parameter",),
        ("accepted", "refitted", "± of the difference", "z", "p (all looked at)"),
    )
    table.add_column("")
    table.add_column("unit")
    for change in verification.parameters:
        table.add_row(
            keyed(change.name, change.joint),
            number_text(change.before, ".5g"),
            number_text(change.after, ".5g"),
            number_text(change.std_error, ".2g"),
            number_text(change.z, ".1f"),
            p_text(change.p_value).removeprefix("= "),
            "changed" if change.changed else "",
            change.unit,
        )
    return table


def window_table(verification: VerificationPart) -> Table:
    """The windows that are simulated worst."""
    table = _table("Worst windows", (), ("from", "to", "RMSE / noise floor"))
    for window in verification.worst_windows:
        table.add_row(f"{window.begin:.4g} s", f"{window.end:.4g} s", number_text(window.ratio, ".3g"))
    return table
